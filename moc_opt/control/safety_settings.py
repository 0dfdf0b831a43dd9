"""Settings of the safety filter: the table ``[guard]`` of a scenario."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from moc_opt.errors import ControlError, MocOptError
from moc_opt.inputs.settings import Level, Settings


class SafetyFilterSettings(Settings):
    """Limits of the safety filter, and actions in a stop. A joint has the largest torque tau_max and speed v_max."""

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    motion: bool = True
    """whether measurements are checked for age, repetition, and agreement of positions, velocities and torques"""
    motion_s: float = Field(0.1, gt=0.0, description="time constant with which the difference q - integral of v decays")
    motion_rad: float = Field(0.001, gt=0.0, description="largest |q - integral of v| of a joint at rest")
    motion_lag_s: float = Field(0.012, ge=0.0)
    """this time multiplied by the joint's largest recent speed is added to motion_rad, because filtered velocities lag.
    At least three time constants of the velocity filter are used"""
    repeat_m: float = Field(0.003, gt=0.0)
    """largest travel of the tip's reference while all encoders repeat their readings (to the last bit, also below)"""
    repeat_torque: float = Field(0.06, gt=0.0)
    """largest change of a torque while all encoders repeat their readings, as a share of tau_max. At
    least 500 times the encoders' step in rad is used"""
    repeat_whole_torque: float = Field(0.0005, gt=0.0)
    """replaces repeat_torque while the wrench sensor also repeats its reading"""
    repeat_whole_m: float = Field(0.0005, gt=0.0)
    """replaces repeat_m while the wrench sensor also repeats its reading"""
    repeat_whole_ticks: int = Field(25, ge=1)
    """largest number of ticks in a row at which a wrench sensor with noise may repeat one reading. It is also the
    largest number of measurements that may equal the measurements a constant time earlier"""
    stuck_torque: float = Field(0.06, ge=0.0)
    """largest change of a joint's momentum residual that static friction explains while the joint's encoder repeats one
    reading, as a share of tau_max. The residual is the observed torque that the model does not explain"""
    stuck_friction: float = Field(6.0, gt=0.0)
    """stuck_torque allows at most this multiple of the Coulomb friction, if the robot's file gives a friction"""
    repeat_joint_ticks: int | None = Field(None, ge=1)
    """largest number of ticks in a row at which one encoder may repeat its reading. If left out, the number follows
    from the encoders' noise and step. With little or no noise, there is then no limit"""
    repeat_reading_ticks: int | None = Field(None, ge=0)
    """largest number of times in a run that one encoder may repeat both position and velocity, or that its readings may
    equal the readings a constant time earlier. If left out, it is patience_ticks for encoders with noise and filtered
    velocities. For other encoders there is then no limit"""
    stuck_rad_per_s: float = Field(0.2, gt=0.0)
    """largest speed that a residual beyond stuck_torque may have given a joint while its encoder repeats one reading.
    At least 600 times the encoders' step in rad is used"""
    residual_torque: float = Field(0.2, gt=0.0)
    """largest difference of a joint's momentum residual from its running mean, as a share of tau_max. If a larger
    difference lasts for more than patience_ticks ticks, the arm is stopped"""
    residual_whole_torque: float = Field(0.5, gt=0.0)
    """largest momentum residual of a joint, as a share of tau_max. If a larger residual lasts for more than
    patience_ticks ticks, the arm is stopped"""
    residual_rate_per_s: float = Field(40.0, gt=0.0, lt=500.0, description="gain of the observer of this residual")
    residual_s: float = Field(0.25, gt=0.0, description="time constant of the residual's running mean")
    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest rate of change of a joint's torque")
    position_margin_rad: float = Field(0.045, ge=0.0)
    """distance from a joint limit at which a virtual wall (spring and damper) begins"""
    position_margin_m: float = Field(0.045, ge=0.0, description="like position_margin_rad, for sliding joints")
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0)
    """stiffness of the wall, which pushes a joint back (N per m for a sliding joint)"""
    wall_damping_Nm_s_per_rad: float = Field(20.0, ge=0.0)
    """damping of a joint's speed beyond the speed that is allowed towards a wall. Inside a wall, no speed is allowed"""
    wall_brake_rad_per_s2: float = Field(2.0, gt=0.0)
    """deceleration a before a wall. At the distance d from the wall, the allowed speed is sqrt(2 a d), at most v_max"""
    jump_rad: float = Field(0.05, gt=0.0)
    """largest motion of a joint between two good measurements, in addition to v_max times the time between them"""
    speed_factor: float = Field(5.0, gt=1.0, description="a measured speed above this multiple of v_max is refused")
    patience_ticks: int = Field(3, ge=0)
    """number of bad or missing measurements in a row that are replaced by extrapolation. One more stops the arm"""
    tip_error_m: float = Field(0.01, gt=0.0)
    """root mean square tip error (distance of the tip from its reference) above which the arm is stopped"""
    tip_error_s: float = Field(0.1, gt=0.0, description="time constant of the mean square of the tip error")
    rcm_error_m: Level = 0.010
    """root mean square RCM error (distance of the shaft from the registered trocar) above which the arm is stopped"""
    rcm_warning_m: Level = Field(0.005, description="root mean square RCM error above which a warning is recorded")
    trocar_force_N: Level = 15.0
    """root mean square force of the trocar on the shaft above which the arm is stopped"""
    trocar_force_warning_N: Level = 8.0
    """root mean square of the trocar force, or of the whole force across the shaft, above which a warning is recorded.
    The whole force includes a load and a contact at the tip"""
    tip_force_N: Level = 10.0
    """largest force across the shaft that is attributed to a contact at the tip. The rest counts as trocar force"""
    incision_s: float = Field(0.1, gt=0.0, description="time constant of the mean squares of RCM error and force")
    stop_damping_Nm_s_per_rad: float = Field(20.0, gt=0.0, description="damping of the drives in a stop")
    stop_holding: float = Field(0.25, ge=0.0, le=1.0)
    """dry friction of the brakes in a stop, as a share of tau_max. With 0, the brakes only damp, and a load sinks"""
    stop_yield_N: Level = 8.0
    """in a stop, a trocar force above this opens the brakes until the force is half of this. Open brakes only damp"""
    stop_yield_s: float = Field(0.4, ge=0.0, le=60.0)
    """longest time for which the brakes stay open. They open again if the trocar force rises by another stop_yield_N"""
    stop_s: float = Field(0.5, gt=0.0)
    """shortest simulated time of a stop. The stop ends when the arm rests, at the latest after 4 times stop_s"""

    @model_validator(mode="after")
    def _warned_before_it_stops(self) -> Self:
        for warning, limit in (("rcm_warning_m", "rcm_error_m"), ("trocar_force_warning_N", "trocar_force_N")):
            low, high = getattr(self, warning), getattr(self, limit)
            if low is not None and high is not None and low > high:
                raise ValueError(f"{warning} = {low:g} is above {limit} = {high:g}: give {warning} at most {high:g}")
        return self
