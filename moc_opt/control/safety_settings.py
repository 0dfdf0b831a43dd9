"""The levels of the safety filter: ``[guard]`` of a scenario."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moc_opt.errors import ControlError, MocOptError
from moc_opt.inputs.settings import Level, Settings
from moc_opt.numerics.arrays import Array

_SETTLED = 6.0
"""Time constants of the residual after which it is what it will be."""
_MOST_TICKS = 1e9
"""As good as never, and still an int of C."""


def _or_never(ticks: int | None) -> float:
    return np.inf if ticks is None else float(ticks)


class MotionSettings(Settings):
    """When a measurement is not believed to show the arm: part of ``[guard]``."""

    motion: bool = Field(True, description="whether age and motion of the measurements are watched")
    motion_s: float = Field(0.1, gt=0.0, description="how long q - integral of v is remembered")
    motion_rad: float = Field(0.001, gt=0.0, description="largest |q - integral of v| of a joint")
    motion_lag_s: float = Field(
        0.012, ge=0.0,
        description="times its recent speed on top of that: velocity readings are filtered, and lag; a scenario takes "
        "three time constants of its filter where they are more",
    )  # fmt: skip
    repeat_m: float = Field(
        0.003, gt=0.0,
        description="way of the reference while all encoders repeat one reading to the last bit: soft gains need as "
        "much to overcome static friction",
    )  # fmt: skip
    repeat_torque: float = Field(
        0.06, gt=0.0, description="change of a torque meanwhile, of tau_max: static friction holds as much"
    )
    repeat_whole_torque: float = Field(
        0.0005, gt=0.0, description="the same where the wrench sensor, too, repeats its reading to the last bit"
    )
    repeat_whole_m: float = Field(0.0005, gt=0.0, description="and the way of the reference in that case")
    repeat_whole_ticks: int = Field(
        25, ge=1,
        description="ticks of that, or of the wrench sensor's repetition alone, at rest too, where that sensor has "
        "noise; and of a recording",
    )
    stuck_torque: float = Field(
        0.06, ge=0.0,
        description="change of a joint's momentum residual, of tau_max, that static friction holds while its encoder "
        "repeats one reading",
    )  # fmt: skip
    stuck_friction: float = Field(
        6.0, gt=0.0, description="the same as a multiple of the Coulomb friction in the robot's file; the lesser counts"
    )
    repeat_joint_ticks: int | None = Field(
        None, ge=1,
        description="ticks in a row in which one encoder may repeat its reading to the last bit; where it is left out, "
        "a scenario works it out from its encoders' noise and step, and without noise there is no limit",
    )  # fmt: skip
    repeat_reading_ticks: int | None = Field(
        None, ge=0,
        description="readings in all in which one encoder, or all of them, may repeat position and velocity to the "
        "last bit; where it is left out, a scenario whose encoders have noise and "
        "filtered velocities allows patience_ticks, and otherwise there is no limit",
    )  # fmt: skip
    stuck_rad_per_s: float = Field(
        0.2, gt=0.0, description="speed that a joint must have gathered by what goes beyond that"
    )
    residual_torque: float = Field(
        0.2, gt=0.0, description="momentum residual of a joint off its own mean, of tau_max, for patience_ticks"
    )
    residual_whole_torque: float = Field(
        0.5, gt=0.0,
        description="that residual itself, its mean not taken off, for as long: no friction, load or push is as large",
    )  # fmt: skip
    residual_rate_per_s: float = Field(40.0, gt=0.0, lt=500.0, description="rate K_o of that residual")
    residual_s: float = Field(0.25, gt=0.0, description="time constant of that mean")

    def replayed_ticks(self, n: int) -> float:
        """Return how many readings of n encoders may have come before, where the wrench sensor has no noise.

        The chance that one encoder with noise shows an earlier reading once more is at most that of repeating itself;
        that all of them do is its n-th power.
        """
        return max(float(self.repeat_whole_ticks), _or_never(self.repeat_joint_ticks) / n)

    def settling_ticks(self, period: float) -> int:
        """Return for how many ticks of ``period`` [s] the residual is on its way to what it will be."""
        return round(min(_SETTLED / (self.residual_rate_per_s * period), _MOST_TICKS))

    def held(self, tau_max: Array, coulomb: Array) -> Array:
        """Return the change of torque (n,) [Nm] that static friction holds; coulomb (n,), 0 where it is not known."""
        known = np.where(coulomb > 0.0, self.stuck_friction * coulomb, np.inf)
        return np.minimum(self.stuck_torque * tau_max, known)

    @property
    def levels(self) -> Array:
        """(15,) as the kernels take them."""
        return np.array([
            self.motion_s, self.motion_rad, self.motion_lag_s, self.repeat_m, self.repeat_torque,
            self.repeat_whole_torque, _or_never(self.repeat_joint_ticks), self.stuck_rad_per_s, self.residual_torque,
            self.residual_rate_per_s, self.residual_s,
            self.repeat_whole_m, self.repeat_whole_ticks, self.residual_whole_torque,
            _or_never(self.repeat_reading_ticks),
        ])  # fmt: skip


class SafetyFilterSettings(MotionSettings):
    """Safety limits."""

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest change of a joint's torque")
    position_margin_rad: float = Field(
        0.045, ge=0.0, description="the wall begins this far inside a joint limit"
    )
    position_margin_m: float = Field(0.045, ge=0.0, description="the same for a joint that slides")
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0, description="torque back, by the depth in the wall")
    wall_damping_Nm_s_per_rad: float = Field(
        20.0, ge=0.0, description="in the wall, and above the speed that is allowed"
    )
    wall_brake_rad_per_s2: float = Field(
        2.0, gt=0.0, description="allowed speed at a distance d from a wall: sqrt(2 d wall_brake)"
    )
    jump_rad: float = Field(
        0.05, gt=0.0, description="a measured step beyond what v_max explains: not believed"
    )
    speed_factor: float = Field(5.0, gt=1.0, description="of v_max: a measured speed above it: not believed")
    patience_ticks: int = Field(
        3, ge=0, description="ticks with a bad measurement that are bridged before the stop"
    )
    tip_error_m: float = Field(
        0.01, gt=0.0, description="root mean square of the tip's error: above it, the loop is out of control"
    )
    tip_error_s: float = Field(0.1, gt=0.0, description="time constant of that mean")
    rcm_error_m: Level = Field(
        0.012, description="root mean square of the shaft's distance from the registered trocar: above it, stop"
    )
    rcm_warning_m: Level = Field(0.006, description="above it, a warning is recorded")
    trocar_force_N: Level = Field(
        15.0, description="root mean square of the trocar's force on the shaft, by the wrench sensor: above it, stop"
    )
    trocar_force_warning_N: Level = Field(8.0, description="above it, a warning is recorded")
    tip_force_N: Level = Field(
        10.0, description="what the tip may press across the shaft: of the whole force the rest counts as the trocar's"
    )
    incision_s: float = Field(0.1, gt=0.0, description="time constant of these two means")
    stop_damping_Nm_s_per_rad: float = Field(20.0, gt=0.0, description="of the drives in a damped stop")
    stop_holding: float = Field(
        0.25, ge=0.0, le=1.0,
        description="dry friction of the brakes in a stop, of tau_max; 0: damping alone, under which an arm sinks",
    )
    stop_yield_N: Level = Field(
        8.0, description="while the trocar presses harder in a stop, the brakes open and damping alone is left"
    )
    stop_yield_s: float = Field(
        0.4, ge=0.0, le=60.0, description="and for no longer: a force that rises by as much more opens them again"
    )
    stop_s: float = Field(
        0.5, gt=0.0, description="how long a stop is watched, and on until the arm rests, 4 times as long at most"
    )

    def position_margins(self, slides: NDArray[np.bool_]) -> Array:
        """Return how far inside the limit of each joint the wall begins, (n,) [rad], [m] where ``slides``."""
        return np.where(slides, self.position_margin_m, self.position_margin_rad)

    @model_validator(mode="after")
    def _warned_before_it_stops(self) -> Self:
        for warning, limit in (("rcm_warning_m", "rcm_error_m"), ("trocar_force_warning_N", "trocar_force_N")):
            low, high = getattr(self, warning), getattr(self, limit)
            if low is not None and high is not None and low > high:
                raise ValueError(f"{warning} = {low:g} is above {limit} = {high:g}: give a lower one")
        return self
