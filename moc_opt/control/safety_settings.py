"""The levels of the safety filter: ``[guard]`` of a scenario."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from moc_opt.errors import ControlError, MocOptError
from moc_opt.inputs.settings import Level, Settings


class SafetyFilterSettings(Settings):
    """Limits of the safety filter, and what it does in a stop.

    The fields up to ``residual_s``, and ``jump_rad``, ``speed_factor`` and ``patience_ticks``, decide whether
    measurements are trusted.
    """

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    motion: bool = True
    """whether the safety filter checks the age of the measurements and the motion that they show"""
    motion_s: float = Field(0.1, gt=0.0, description="time over which q - integral of v is remembered")
    motion_rad: float = Field(0.001, gt=0.0, description="largest |q - integral of v| of a joint")
    motion_lag_s: float = Field(0.012, ge=0.0)
    """this time multiplied by the joint's recent speed is added to motion_rad, since filtered velocities lag; a
    scenario uses at least three time constants of its velocity filter"""
    repeat_m: float = Field(0.003, gt=0.0)
    """largest travel of the reference while all encoders repeat one reading to the last bit: soft gains need
    about this much to overcome static friction"""
    repeat_torque: float = Field(0.06, gt=0.0)
    """largest change of a torque during that repetition, as a share of tau_max: static friction holds about
    this much"""
    repeat_whole_torque: float = Field(0.0005, gt=0.0)
    """replaces repeat_torque where the wrench sensor repeats its reading to the last bit too"""
    repeat_whole_m: float = Field(0.0005, gt=0.0)
    """replaces repeat_m where the wrench sensor repeats its reading to the last bit too"""
    repeat_whole_ticks: int = Field(25, ge=1)
    """ticks in a row for which a wrench sensor with noise may repeat its reading to the last bit, alone or with all
    encoders; also how many readings in a row may repeat readings equally far back before they count as a replay"""
    stuck_torque: float = Field(0.06, ge=0.0)
    """while an encoder repeats one reading: change of its joint's momentum residual that static friction
    explains, as a share of tau_max"""
    stuck_friction: float = Field(6.0, gt=0.0)
    """the same change as a multiple of the Coulomb friction in the robot's file; the smaller of both counts"""
    repeat_joint_ticks: int | None = Field(None, ge=1)
    """ticks in a row for which one encoder may repeat its reading to the last bit; if left out, a scenario
    computes it from the encoders' noise and step; without noise there is no limit"""
    repeat_reading_ticks: int | None = Field(None, ge=0)
    """number of readings in a run in which one encoder, or all of them, may repeat position and velocity to the
    last bit; if left out, it is patience_ticks in a scenario whose encoders have noise and filtered velocities,
    and otherwise there is no limit"""
    stuck_rad_per_s: float = Field(0.2, gt=0.0)
    """while an encoder repeats one reading: largest speed that its joint may have been given by torque above
    stuck_torque"""
    residual_torque: float = Field(0.2, gt=0.0)
    """largest distance of a joint's momentum residual from its own mean, as a share of tau_max; it may be
    exceeded for patience_ticks"""
    residual_whole_torque: float = Field(0.5, gt=0.0)
    """largest momentum residual itself, as a share of tau_max, for the same time: no friction, load or push is
    as large"""
    residual_rate_per_s: float = Field(40.0, gt=0.0, lt=500.0, description="rate K_o of the momentum residual")
    residual_s: float = Field(0.25, gt=0.0, description="time constant of the residual's mean")
    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest change of a joint's torque")
    position_margin_rad: float = Field(0.045, ge=0.0)
    """distance from a joint limit at which the wall begins"""
    position_margin_m: float = Field(0.045, ge=0.0, description="position_margin_rad for a sliding joint")
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0)
    """stiffness of the wall: torque back per depth in it"""
    wall_damping_Nm_s_per_rad: float = Field(20.0, ge=0.0)
    """damping in the wall, and of a joint that is faster than allowed"""
    wall_brake_rad_per_s2: float = Field(2.0, gt=0.0)
    """deceleration a before a wall: at the distance d from it, the allowed speed is sqrt(2 a d)"""
    jump_rad: float = Field(0.05, gt=0.0)
    """a measured step that exceeds what v_max explains by more than this is refused"""
    speed_factor: float = Field(5.0, gt=1.0, description="a measured speed above this multiple of v_max is refused")
    patience_ticks: int = Field(3, ge=0)
    """ticks with a bad measurement that are bridged before the stop"""
    tip_error_m: float = Field(0.01, gt=0.0)
    """limit of the root mean square of the tip's error; above it the arm is stopped"""
    tip_error_s: float = Field(0.1, gt=0.0, description="time constant of that mean")
    rcm_error_m: Level = 0.010
    """limit of the root mean square of the shaft's distance from the registered trocar; above it the arm is stopped"""
    rcm_warning_m: Level = Field(0.005, description="level of the same mean above which a warning is recorded")
    trocar_force_N: Level = 15.0
    """limit of the root mean square of the trocar's force on the shaft, as the wrench sensor shows it; above it
    the arm is stopped"""
    trocar_force_warning_N: Level = 8.0
    """level of that mean, or of the same mean of the whole force across the shaft, a load's and the tip's
    included, above which a warning is recorded"""
    tip_force_N: Level = 10.0
    """largest force across the shaft that is attributed to the tip; the rest counts as the trocar's"""
    incision_s: float = Field(0.1, gt=0.0, description="time constant of the means of RCM error and trocar force")
    stop_damping_Nm_s_per_rad: float = Field(20.0, gt=0.0, description="damping of the drives in a stop")
    stop_holding: float = Field(0.25, ge=0.0, le=1.0)
    """dry friction of the brakes in a stop, as a share of tau_max; 0: damping only, under which an arm sinks"""
    stop_yield_N: Level = 8.0
    """in a stop, while the trocar's force is above this, the brakes open and only damping is left"""
    stop_yield_s: float = Field(0.4, ge=0.0, le=60.0)
    """longest time for which the brakes open; a force that rises by stop_yield_N more opens them again"""
    stop_s: float = Field(0.5, gt=0.0)
    """least time for which a stop is simulated; it goes on until the arm rests, at most 4 times as long"""

    @model_validator(mode="after")
    def _warned_before_it_stops(self) -> Self:
        for warning, limit in (("rcm_warning_m", "rcm_error_m"), ("trocar_force_warning_N", "trocar_force_N")):
            low, high = getattr(self, warning), getattr(self, limit)
            if low is not None and high is not None and low > high:
                raise ValueError(f"{warning} = {low:g} is above {limit} = {high:g}: give a lower one")
        return self
