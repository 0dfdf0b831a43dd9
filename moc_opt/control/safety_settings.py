"""Settings of the safety filter: the table ``[guard]`` of a scenario."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from moc_opt.errors import ControlError, MocOptError
from moc_opt.inputs.settings import Level, Settings


class SafetyFilterSettings(Settings):
    """The safety filter's limits, and its actions in a stop. A joint's limits are tau_max (torque) and v_max (speed).

    The fields from ``motion`` to ``residual_s``, and ``jump_rad``, ``speed_factor`` and ``patience_ticks``, decide
    whether measurements are trusted.
    """

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    motion: bool = True
    """whether measurements are checked for age, repetition, and agreement of positions, velocities and torques"""
    motion_s: float = Field(0.1, gt=0.0, description="time constant with which the difference q - integral of v decays")
    motion_rad: float = Field(0.001, gt=0.0, description="largest |q - integral of v| of a joint at rest")
    motion_lag_s: float = Field(0.012, ge=0.0)
    """this time multiplied by the joint's largest recent speed is added to motion_rad, because filtered velocities lag;
    a scenario uses at least three time constants of its velocity filter"""
    repeat_m: float = Field(0.003, gt=0.0)
    """largest travel of the tip's reference while all encoders repeat one reading to the last bit; with soft gains, the
    arm overcomes its static friction after about this much travel"""
    repeat_torque: float = Field(0.06, gt=0.0)
    """largest change of a torque while all encoders repeat one reading, as a share of tau_max; static friction holds
    about this much; a scenario uses at least 500 times the encoders' step in rad"""
    repeat_whole_torque: float = Field(0.0005, gt=0.0)
    """replaces repeat_torque while the wrench sensor repeats its reading to the last bit too"""
    repeat_whole_m: float = Field(0.0005, gt=0.0)
    """replaces repeat_m while the wrench sensor repeats its reading to the last bit too"""
    repeat_whole_ticks: int = Field(25, ge=1)
    """ticks in a row for which a wrench sensor with noise may repeat one reading to the last bit. Also the number of
    whole measurements that may equal earlier ones at a constant lag before they count as a replay"""
    stuck_torque: float = Field(0.06, ge=0.0)
    """largest change of a joint's momentum residual that static friction can explain while the joint's encoder repeats
    one reading, as a share of tau_max"""
    stuck_friction: float = Field(6.0, gt=0.0)
    """the same change as a multiple of the Coulomb friction in the robot's file; the smaller of both values is used"""
    repeat_joint_ticks: int | None = Field(None, ge=1)
    """ticks in a row for which one encoder may repeat its reading to the last bit; left out: a scenario computes this
    number from the encoders' noise and step, and sets no limit if they have no noise or very little"""
    repeat_reading_ticks: int | None = Field(None, ge=0)
    """number of readings in a run in which one encoder may repeat position and velocity to the last bit; left out:
    patience_ticks in a scenario whose encoders have noise and filtered velocities, otherwise no limit. Also the number
    of readings of one encoder that may equal earlier ones at a constant lag"""
    stuck_rad_per_s: float = Field(0.2, gt=0.0)
    """largest speed that the torque beyond stuck_torque may have given a joint while its encoder repeats one reading;
    a scenario uses at least 600 times the encoders' step in rad"""
    residual_torque: float = Field(0.2, gt=0.0)
    """largest difference of a joint's momentum residual from its running mean, as a share of tau_max; the arm is
    stopped if it is exceeded on more than patience_ticks ticks in a row"""
    residual_whole_torque: float = Field(0.5, gt=0.0)
    """largest momentum residual, as a share of tau_max; the arm is stopped if it is exceeded on more than
    patience_ticks ticks in a row. Friction, loads and pushes stay below it"""
    residual_rate_per_s: float = Field(40.0, gt=0.0, lt=500.0, description="gain K_o of the momentum residual")
    residual_s: float = Field(0.25, gt=0.0, description="time constant of the residual's running mean")
    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest rate of change of a joint's torque")
    position_margin_rad: float = Field(0.045, ge=0.0)
    """distance from a joint limit at which a virtual wall begins: a spring with damping"""
    position_margin_m: float = Field(0.045, ge=0.0, description="the same for a sliding joint")
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0)
    """stiffness of the wall: torque that pushes a joint back, per rad of depth in the wall (sliding joint: N per m)"""
    wall_damping_Nm_s_per_rad: float = Field(20.0, ge=0.0)
    """damping of a joint that moves towards a limit faster than is allowed; inside the wall, the allowed speed is 0"""
    wall_brake_rad_per_s2: float = Field(2.0, gt=0.0)
    """deceleration a before a wall: at the distance d from the wall, the allowed speed is sqrt(2 a d), at most v_max"""
    jump_rad: float = Field(0.05, gt=0.0)
    """a measurement is refused if a joint moved by more than this plus v_max times the time since the last good one"""
    speed_factor: float = Field(5.0, gt=1.0, description="a measured speed above this multiple of v_max is refused")
    patience_ticks: int = Field(3, ge=0)
    """number of bad or missing measurements in a row that are bridged by extrapolation; one more stops the arm"""
    tip_error_m: float = Field(0.01, gt=0.0)
    """limit of the root mean square of the tip's distance from its reference; above it the arm is stopped"""
    tip_error_s: float = Field(0.1, gt=0.0, description="time constant of the mean square of the tip's distance")
    rcm_error_m: Level = 0.010
    """limit of the root mean square of the shaft's distance from the registered trocar; above it the arm is stopped"""
    rcm_warning_m: Level = Field(0.005, description="a warning is recorded if the same root mean square is above this")
    trocar_force_N: Level = 15.0
    """limit of the root mean square of the trocar's force on the shaft, computed from the wrench sensor's reading;
    above it the arm is stopped"""
    trocar_force_warning_N: Level = 8.0
    """a warning is recorded if the root mean square of this force, or of the whole force across the shaft, is above
    this level; the whole force includes those of a load and of a contact at the tip"""
    tip_force_N: Level = 10.0
    """largest force across the shaft that is attributed to a contact at the tip; the rest counts as trocar force"""
    incision_s: float = Field(0.1, gt=0.0, description="time constant of the mean squares of RCM error and force")
    stop_damping_Nm_s_per_rad: float = Field(20.0, gt=0.0, description="damping of the drives in a stop")
    stop_holding: float = Field(0.25, ge=0.0, le=1.0)
    """dry friction of the brakes in a stop, as a share of tau_max; 0: damping alone, so that an unknown load sinks"""
    stop_yield_N: Level = 8.0
    """in a stop, a larger trocar force opens the brakes until the force is half of this; open brakes only damp"""
    stop_yield_s: float = Field(0.4, ge=0.0, le=60.0)
    """longest time for which the brakes stay open; they open again if the force has risen by another stop_yield_N"""
    stop_s: float = Field(0.5, gt=0.0)
    """shortest time for which a stop is simulated; the stop ends when the arm rests, or after 4 times stop_s"""

    @model_validator(mode="after")
    def _warned_before_it_stops(self) -> Self:
        for warning, limit in (("rcm_warning_m", "rcm_error_m"), ("trocar_force_warning_N", "trocar_force_N")):
            low, high = getattr(self, warning), getattr(self, limit)
            if low is not None and high is not None and low > high:
                raise ValueError(f"{warning} = {low:g} is above {limit} = {high:g}: give {warning} at most {high:g}")
        return self
