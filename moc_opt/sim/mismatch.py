"""How this plant differs from the robot the controller was told of: drawn once, from a seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from moc_opt.numerics.arrays import Array, read_only
from moc_opt.robots import RobotData
from moc_opt.sim.settings import PlantSettings


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Differences between plant and controller's model; arrays are read-only."""

    mass_scale: Mapping[str, float]
    """Link -> factor on its mass and inertia."""
    viscous_friction: Array
    """(n,) [Nm s/rad]"""
    coulomb_friction: Array
    """(n,) [Nm]"""
    registration_error: Array
    """(3,) true trocar minus the one the controller is told, world axes [m]."""
    origin_shift: Array
    """(n + 1, 3) true minus modelled origin of each joint, then of the tool's mount, axes of the link before it [m]."""
    origin_turn: Array
    """(n, 3) rotation vector of each joint's frame against the model, axes of the link before it [rad]."""
    encoder_bias: Array
    """(n,) what each encoder shows minus what is [rad, or m of a sliding joint]."""
    ripple_phase: Array
    """(n,) of the torque ripple at joint position 0 [rad]."""

    @property
    def displaces(self) -> bool:
        """Whether tip and shaft are elsewhere than the model puts them at the encoders' readings."""
        return bool(self.origin_shift.any() or self.origin_turn.any() or self.encoder_bias.any())

    @classmethod
    def draw(
        cls, data: RobotData, settings: PlantSettings, links: Sequence[str], seed: np.random.SeedSequence
    ) -> Mismatch:
        """Draw factors uniform in 1 +- error, one per link and per joint, and directions of offsets uniform.

        The random numbers do not depend on the settings: twice the error puts all twice as far off, and each kind of
        error has a stream of its own.
        """
        of_links, of_joints, of_trocar, of_origins, of_axes, of_encoders, of_ripple = (
            np.random.default_rng(child) for child in seed.spawn(7)
        )
        masses = 1.0 + settings.mass_error * of_links.uniform(-1.0, 1.0, len(links))
        friction = 1.0 + settings.friction_error * of_joints.uniform(-1.0, 1.0, (2, data.n))
        friction *= settings.friction
        direction = of_trocar.standard_normal(3)
        offset = settings.trocar_registration_error_m * direction / np.linalg.norm(direction)
        viscous, coulomb = friction[0] * data.viscous_friction, friction[1] * data.coulomb_friction
        shift = settings.calibration_error_m * _directions(of_origins, data.n + 1)
        turn = settings.calibration_tilt_rad * _directions(of_axes, data.n)
        bias = settings.encoder_bias_rad * of_encoders.standard_normal(data.n)
        phase = of_ripple.uniform(0.0, 2.0 * np.pi, data.n)
        arrays = map(read_only, (viscous, coulomb, offset, shift, turn, bias, phase))
        scales = {link: float(factor) for link, factor in zip(links, masses, strict=True)}
        return cls(MappingProxyType(scales), *arrays)


def _directions(rng: np.random.Generator, count: int) -> Array:
    """Return (count, 3) unit vectors, uniform over the sphere."""
    rows = rng.standard_normal((count, 3))
    found: Array = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return found
