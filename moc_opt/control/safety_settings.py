"""The levels of the safety filter: ``[guard]`` of a scenario."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moc_opt.arrays import Array
from moc_opt.errors import ControlError, MocOptError
from moc_opt.inputs.settings import Level, Settings

_SETTLED = 6.0  #: Time constants of the residual after which it is what it will be.
_MOST_TICKS = 1e9  #: As good as never, and still an int of C.


def _or_never(ticks: int | None) -> float:
    return np.inf if ticks is None else float(ticks)


class MotionSettings(Settings):
    """When a measurement is not believed to show the arm: part of ``[guard]``."""

    motion: bool = Field(
        True, description="whether the safety filter checks the age of the measurements and the motion that they show"
    )
    motion_s: float = Field(0.1, gt=0.0, description="time over which q - integral of v is remembered")
    motion_rad: float = Field(0.001, gt=0.0, description="largest |q - integral of v| of a joint")
    motion_lag_s: float = Field(
        0.012, ge=0.0,
        description="this time multiplied by the joint's recent speed is added to motion_rad, since filtered "
        "velocities lag; a scenario uses at least three time constants of its velocity filter",
    )  # fmt: skip
    repeat_m: float = Field(
        0.003, gt=0.0,
        description="largest way of the reference while all encoders repeat one reading to the last bit: soft gains "
        "need about this much to overcome static friction",
    )  # fmt: skip
    repeat_torque: float = Field(
        0.06, gt=0.0,
        description="largest change of a torque during that repetition, as a share of tau_max: static friction holds "
        "about this much",
    )  # fmt: skip
    repeat_whole_torque: float = Field(
        0.0005, gt=0.0,
        description="replaces repeat_torque where the wrench sensor repeats its reading to the last bit too",
    )  # fmt: skip
    repeat_whole_m: float = Field(
        0.0005, gt=0.0, description="replaces repeat_m where the wrench sensor repeats its reading to the last bit too"
    )
    repeat_whole_ticks: int = Field(
        25, ge=1,
        description="ticks in a row for which a wrench sensor with noise may repeat its reading to the last bit, alone "
        "or with all encoders; also how many readings in a row may repeat readings equally far back before "
        "they count as a replay",
    )  # fmt: skip
    stuck_torque: float = Field(
        0.06, ge=0.0,
        description="while an encoder repeats one reading: change of its joint's momentum residual that static "
        "friction explains, as a share of tau_max",
    )  # fmt: skip
    stuck_friction: float = Field(
        6.0, gt=0.0,
        description="the same change as a multiple of the Coulomb friction in the robot's file; the smaller of both "
        "counts",
    )  # fmt: skip
    repeat_joint_ticks: int | None = Field(
        None, ge=1,
        description="ticks in a row for which one encoder may repeat its reading to the last bit; if left out, a "
        "scenario computes it from the encoders' noise and step; without noise there is no limit",
    )  # fmt: skip
    repeat_reading_ticks: int | None = Field(
        None, ge=0,
        description="number of readings in a run in which one encoder, or all of them, may repeat position and "
        "velocity to the last bit; if left out, it is patience_ticks in a scenario whose encoders have noise and "
        "filtered velocities, and otherwise there is no limit",
    )  # fmt: skip
    stuck_rad_per_s: float = Field(
        0.2, gt=0.0,
        description="while an encoder repeats one reading: largest speed that its joint may have been given by "
        "torque above stuck_torque",
    )  # fmt: skip
    residual_torque: float = Field(
        0.2, gt=0.0,
        description="largest distance of a joint's momentum residual from its own mean, as a share of tau_max; it may "
        "be exceeded for patience_ticks",
    )  # fmt: skip
    residual_whole_torque: float = Field(
        0.5, gt=0.0,
        description="largest momentum residual itself, as a share of tau_max, for the same time: no friction, load or "
        "push is as large",
    )  # fmt: skip
    residual_rate_per_s: float = Field(40.0, gt=0.0, lt=500.0, description="rate K_o of the momentum residual")
    residual_s: float = Field(0.25, gt=0.0, description="time constant of the residual's mean")

    def replayed_ticks(self, n: int) -> float:
        """Return how many readings of n encoders may repeat earlier ones, where the wrench sensor has no noise.

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


class SafetyFilterSettings(MotionSettings):
    """Safety limits."""

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest change of a joint's torque")
    position_margin_rad: float = Field(
        0.045, ge=0.0, description="distance from a joint limit at which the wall begins"
    )
    position_margin_m: float = Field(0.045, ge=0.0, description="position_margin_rad for a sliding joint")
    wall_stiffness_Nm_per_rad: float = Field(
        2000.0, ge=0.0, description="stiffness of the wall: torque back per depth in it"
    )
    wall_damping_Nm_s_per_rad: float = Field(
        20.0, ge=0.0, description="damping in the wall, and of a joint that is faster than allowed"
    )
    wall_brake_rad_per_s2: float = Field(
        2.0, gt=0.0,
        description="deceleration a before a wall: at the distance d from it, the allowed speed is sqrt(2 a d)",
    )  # fmt: skip
    jump_rad: float = Field(
        0.05, gt=0.0, description="a measured step that exceeds what v_max explains by more than this is refused"
    )
    speed_factor: float = Field(5.0, gt=1.0, description="a measured speed above this multiple of v_max is refused")
    patience_ticks: int = Field(
        3, ge=0, description="ticks with a bad measurement that are bridged before the stop"
    )
    tip_error_m: float = Field(
        0.01, gt=0.0, description="limit of the root mean square of the tip's error; above it the arm is stopped"
    )
    tip_error_s: float = Field(0.1, gt=0.0, description="time constant of that mean")
    rcm_error_m: Level = Field(
        0.010,
        description="limit of the root mean square of the shaft's distance from the registered trocar; above it the "
        "arm is stopped",
    )
    rcm_warning_m: Level = Field(0.005, description="level of the same mean above which a warning is recorded")
    trocar_force_N: Level = Field(
        15.0,
        description="limit of the root mean square of the trocar's force on the shaft, as the wrench sensor shows it; "
        "above it the arm is stopped",
    )
    trocar_force_warning_N: Level = Field(
        8.0,
        description="level of that mean, or of the same mean of the whole force across the shaft, a load's and the "
        "tip's included, above which a warning is recorded",
    )
    tip_force_N: Level = Field(
        10.0,
        description="largest force across the shaft that is attributed to the tip; the rest counts as the trocar's",
    )
    incision_s: float = Field(0.1, gt=0.0, description="time constant of the means of RCM error and trocar force")
    stop_damping_Nm_s_per_rad: float = Field(20.0, gt=0.0, description="damping of the drives in a stop")
    stop_holding: float = Field(
        0.25, ge=0.0, le=1.0,
        description="dry friction of the brakes in a stop, as a share of tau_max; 0: damping only, under which an arm "
        "sinks",
    )  # fmt: skip
    stop_yield_N: Level = Field(
        8.0, description="in a stop, while the trocar's force is above this, the brakes open and only damping is left"
    )
    stop_yield_s: float = Field(
        0.4, ge=0.0, le=60.0,
        description="longest time for which the brakes open; a force that rises by stop_yield_N more opens them again",
    )  # fmt: skip
    stop_s: float = Field(
        0.5, gt=0.0,
        description="least time for which a stop is simulated; it goes on until the arm rests, at most 4 times as long",
    )  # fmt: skip

    def position_margins(self, slides: NDArray[np.bool_]) -> Array:
        """Return how far inside the limit of each joint the wall begins, (n,) [rad], [m] where ``slides``."""
        return np.where(slides, self.position_margin_m, self.position_margin_rad)

    @property
    def incision_levels(self) -> tuple[tuple[float | None, float | None], tuple[float | None, float | None]]:
        """Warning level and limit of RCM error [m] and of the trocar's force [N]; None: off."""
        return (self.rcm_warning_m, self.rcm_error_m), (self.trocar_force_warning_N, self.trocar_force_N)

    @model_validator(mode="after")
    def _warned_before_it_stops(self) -> Self:
        for warning, limit in (("rcm_warning_m", "rcm_error_m"), ("trocar_force_warning_N", "trocar_force_N")):
            low, high = getattr(self, warning), getattr(self, limit)
            if low is not None and high is not None and low > high:
                raise ValueError(f"{warning} = {low:g} is above {limit} = {high:g}: give a lower one")
        return self
