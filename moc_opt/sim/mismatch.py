"""How this plant differs from the robot the controller was told of: drawn once, from a seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from moc_opt.robots import RobotData
from moc_opt.sim.settings import PlantSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mismatch:
    """What the controller's model does not know; arrays are read-only."""

    mass_scale: Mapping[str, float]
    """Link -> factor on its mass and inertia."""
    viscous_friction: Array
    """(n,) [Nm s/rad]"""
    coulomb_friction: Array
    """(n,) [Nm]"""
    registration_error: Array
    """(3,) true trocar minus the one the controller is told, world axes [m]."""

    @classmethod
    def draw(
        cls, data: RobotData, settings: PlantSettings, links: Sequence[str], seed: np.random.SeedSequence
    ) -> Mismatch:
        """Draw it: factors uniform in 1 +- error, one per link and per joint; the offset's direction uniform.

        The random numbers do not depend on the settings: twice the error puts all twice as far off.
        """
        of_links, of_joints, of_trocar = (np.random.default_rng(child) for child in seed.spawn(3))
        masses = 1.0 + settings.mass_error * of_links.uniform(-1.0, 1.0, len(links))
        friction = 1.0 + settings.friction_error * of_joints.uniform(-1.0, 1.0, (2, data.n))
        friction *= settings.friction
        direction = of_trocar.standard_normal(3)
        offset = settings.trocar_registration_error_m * direction / np.linalg.norm(direction)
        viscous, coulomb = friction[0] * data.viscous_friction, friction[1] * data.coulomb_friction
        for array in (viscous, coulomb, offset):
            array.flags.writeable = False
        scales = {link: float(factor) for link, factor in zip(links, masses, strict=True)}
        return cls(MappingProxyType(scales), viscous, coulomb, offset)
