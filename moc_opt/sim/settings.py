"""Settings of the plant, and its differences from the controller's model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from moc_opt.arrays import Array, read_only
from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Settings
from moc_opt.robots import RobotData

GRAVITY = (0.0, 0.0, -9.81)  #: [m/s^2], world axes.
_COARSEST_SUBSTEP_S = 1e-3
_Stiffness = Annotated[float, Field(gt=0, le=1e9)]


class PlantSettings(Settings):
    """The simulated arm, its trocar and its sensors. The value 0 switches off an error, noise, ripple or delay.

    Raises:
        PlantError: a value is out of range.
        UnknownNameError: a field does not exist.
    """

    KIND: ClassVar[str] = "[plant]"
    MORE_KEYS: ClassVar[tuple[str, ...]] = ("preset",)
    ERROR: ClassVar[type[MocOptError]] = PlantError

    period_s: float = Field(0.002, gt=0, le=0.1, description="control period (time between two torque commands)")
    substeps: int = Field(2, ge=1, le=1000)
    """number of simulation steps per control period. A step may last 1 ms at most"""
    gravity: bool = Field(True, description="whether gravity acts (9.81 m/s^2 along -z)")
    mass_error: float = Field(0.10, ge=0, le=0.9)
    """largest relative error of each link's mass and inertia. The errors are drawn uniformly"""
    friction: float = Field(1.0, ge=0, le=10)
    """factor on the viscous and Coulomb friction in the robot's file"""
    friction_error: float = Field(0.20, ge=0, lt=1)
    """largest relative error of each joint's friction. The errors are drawn uniformly"""
    calibration_error_m: float = Field(0.0002, ge=0, le=0.05)
    """size of the position errors of joint frames and tool mount in the controller's model, in random directions"""
    calibration_tilt_rad: float = Field(0.0001, ge=0, le=0.1)
    """angle of the orientation errors of joint frames in the controller's model, about random axes"""
    encoder_bias_rad: float = Field(0.0001, ge=0, le=0.1)
    """standard deviation of the encoders' constant errors, one per joint"""
    encoder_noise_rad: float = Field(1e-5, ge=0, le=0.1, description="standard deviation of the encoders' noise")
    encoder_resolution_rad: float = Field(2.4e-5, ge=0, le=0.1)
    """smallest step of an encoder's reading. The default is one turn divided by 2^18"""
    velocity_cutoff_Hz: float = Field(50.0, ge=0)
    """cut-off frequency of the low-pass filter on differentiated positions. 0: no filter"""
    encoder_side: Literal["link", "motor"] = Field("link", description="side of an elastic joint that encoders measure")
    joint_stiffness_Nm_per_rad: Annotated[float, Field(ge=0, le=1e9)] | tuple[_Stiffness, ...] = 0.0
    """stiffness of the spring between motor and link, for all joints or per joint. 0: rigid joints"""
    joint_spring_damping_Nm_s_per_rad: float = Field(30.0, ge=0, le=1e4)
    """damping parallel to the spring between motor and link"""
    torque_ripple: float = Field(0.0, ge=0, le=0.5)
    """amplitude of the torque ripple, as a share of the joint's largest torque"""
    torque_ripple_per_turn: float = Field(200.0, gt=0, le=1e5)
    """number of periods of the torque ripple in one turn of the joint"""
    force_noise_N: float = Field(0.05, ge=0, description="standard deviation of the wrench sensor's force, per axis")
    torque_noise_Nm: float = Field(0.002, ge=0)
    """standard deviation of the wrench sensor's torque, per axis"""
    delay_ticks: int = Field(1, ge=0, le=100, description="number of periods from a torque command to its effect")
    trocar_stiffness_N_per_m: float = Field(800.0, ge=0, le=1e6)
    """stiffness of the abdominal wall at the trocar. 500 to 3000 is realistic"""
    trocar_damping_Ns_per_m: float = Field(10.0, ge=0, le=1e4)
    """damping of the abdominal wall at the trocar"""
    trocar_registration_error_m: float = Field(0.0005, ge=0, le=0.1)
    """distance between the true trocar and the trocar position that the controller uses"""

    @model_validator(mode="after")
    def _fine_enough(self) -> Self:
        if self.period_s / self.substeps > _COARSEST_SUBSTEP_S * (1 + 1e-9):
            need = math.ceil(self.period_s / _COARSEST_SUBSTEP_S - 1e-9)
            raise ValueError(
                f"substeps = {self.substeps} makes plant steps of {1e3 * self.substep_s:g} ms; "
                f"raise substeps to {need} or more (a step may last 1 ms at most)"
            )
        return self

    @property
    def elastic(self) -> bool:
        """Whether joints have springs."""
        return self.joint_stiffness_Nm_per_rad != 0.0

    @property
    def substep_s(self) -> float:
        """Duration of a simulation step."""
        return self.period_s / self.substeps

    @classmethod
    def nominal(cls, **changes: Any) -> PlantSettings:
        """Make settings of a plant that equals the controller's model, except for ``changes``."""
        zero = (
            "mass_error", "friction", "friction_error", "calibration_error_m", "calibration_tilt_rad",
            "encoder_bias_rad", "encoder_noise_rad", "encoder_resolution_rad", "velocity_cutoff_Hz",
            "joint_stiffness_Nm_per_rad", "torque_ripple", "force_noise_N", "torque_noise_Nm", "delay_ticks",
            "trocar_registration_error_m",
        )  # fmt: skip
        return cls(**dict.fromkeys(zero, 0) | changes)


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Random parameters in which the plant differs from the controller's model."""

    mass_scale: Mapping[str, float]  #: Factor on mass and inertia, by name of the link.
    viscous_friction: Array  #: (n,) [Nm s/rad].
    coulomb_friction: Array  #: (n,) [Nm].
    registration_error: Array  #: (3,) true minus registered trocar, world axes [m].
    origin_shift: Array
    """(n + 1, 3) true minus modelled origin of joints and tool mount, in the preceding link's axes [m]."""
    origin_turn: Array
    """(n, 3) rotation vector from modelled to true joint frame, in the preceding link's axes [rad]."""
    encoder_bias: Array  #: (n,) reading minus true position [rad, m].
    ripple_phase: Array  #: (n,) phase of the ripple at joint position 0 [rad].

    @property
    def displaces(self) -> bool:
        """Whether tip and shaft differ from those of the controller's model."""
        return bool(self.origin_shift.any() or self.origin_turn.any() or self.encoder_bias.any())

    @classmethod
    def draw(
        cls, data: RobotData, settings: PlantSettings, links: Sequence[str], seed: np.random.SeedSequence
    ) -> Mismatch:
        """Draw the differences. ``links`` are the names of all links with mass."""
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
    rows = rng.standard_normal((count, 3))
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))
