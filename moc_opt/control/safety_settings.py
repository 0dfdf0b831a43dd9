"""Settings of the safety filter: the table ``[guard]`` of a scenario."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from moc_opt.errors import ControlError, MocOptError
from moc_opt.inputs.settings import Level, Settings


class SafetyFilterSettings(Settings):
    """Limits of the safety filter, and its actions when it stops the arm."""

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    motion: bool = True
    """whether measurements are checked for age, repetition, and agreement of positions, velocities and torques"""
    motion_s: float = Field(0.1, gt=0.0)
    """time constant of the comparison of a joint's position with its integrated velocity"""
    motion_rad: float = Field(0.001, gt=0.0)
    """largest difference between the position of a resting joint and its integrated velocity"""
    motion_lag_s: float = Field(0.012, ge=0.0)
    """lag of measured velocities. At the speed v, the lag times v is added to `motion_rad`. The lag is at least three
    time constants of the velocity filter"""
    repeat_m: float = Field(0.003, gt=0.0)
    """largest travel of the tip's reference while all encoders repeat their readings"""
    repeat_torque: float = Field(0.06, gt=0.0)
    """largest torque change while all encoders repeat their readings, as a share of the largest torque. The share is
    at least 500 times `encoder_resolution_rad`"""
    repeat_whole_torque: float = Field(0.0005, gt=0.0)
    """largest torque change while encoders and wrench sensor repeat their readings, as a share of the largest torque"""
    repeat_whole_m: float = Field(0.0005, gt=0.0)
    """largest travel of the tip's reference while encoders and wrench sensor repeat their readings"""
    repeat_whole_ticks: int = Field(25, ge=1)
    """largest number of consecutive control periods in which a noisy wrench sensor repeats its reading. It also limits
    the number of consecutive measurements that equal those a fixed time earlier (a replay)"""
    stuck_torque: float = Field(0.06, ge=0.0)
    """largest torque change that static friction may explain while one encoder repeats its reading, as a share of its
    joint's largest torque"""
    stuck_friction: float = Field(6.0, gt=0.0)
    """like `stuck_torque`, but as a multiple of the joint's Coulomb friction. The smaller of the two torques is used"""
    repeat_joint_ticks: int | None = Field(None, ge=1)
    """largest number of consecutive control periods in which one encoder repeats its position. By default, it is
    computed from the encoders' noise and step"""
    repeat_reading_ticks: int | None = Field(None, ge=0)
    """largest total number of control periods of a run in which one encoder repeats both position and velocity. By
    default, it is `patience_ticks` for noisy encoders with filtered velocities, and unlimited for others"""
    stuck_rad_per_s: float = Field(0.2, gt=0.0)
    """threshold of the speed that a joint must have gained while its encoder repeats its reading. Above it, the encoder
    counts as stuck. The torque beyond `stuck_torque` gives this speed. The threshold is at least 600 times
    `encoder_resolution_rad`"""
    residual_torque: float = Field(0.2, gt=0.0)
    """largest change of a joint's momentum residual (torque implied by the joint's motion, minus the command), as a
    share of the joint's largest torque. Above it for more than `patience_ticks` control periods, the arm is stopped"""
    residual_whole_torque: float = Field(0.5, gt=0.0)
    """like `residual_torque`, but for the momentum residual itself instead of its change"""
    residual_rate_per_s: float = Field(40.0, gt=0.0, lt=500.0)
    """gain of the observer that estimates the momentum residuals"""
    residual_s: float = Field(0.25, gt=0.0)
    """time constant of the running mean from which `residual_torque` measures changes"""
    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest rate of change of a joint's torque")
    position_margin_rad: float = Field(0.045, ge=0.0)
    """distance of the virtual wall (a spring) from a revolute joint's limit"""
    position_margin_m: float = Field(0.045, ge=0.0)
    """distance of the virtual wall (a spring) from a prismatic joint's limit"""
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0)
    """stiffness of the virtual wall (prismatic joints: N/m)"""
    wall_damping_Nm_s_per_rad: float = Field(20.0, ge=0.0)
    """damping of a joint's speed beyond the largest speed, see `wall_brake_rad_per_s2` (prismatic joints: N s/m)"""
    wall_brake_rad_per_s2: float = Field(2.0, gt=0.0)
    """deceleration a before the virtual wall. At the distance d from the wall, the largest speed is sqrt(2 a d)"""
    jump_rad: float = Field(0.05, gt=0.0)
    """largest change of a measured joint position beyond the travel at its speed limit (see `patience_ticks`)"""
    speed_factor: float = Field(5.0, gt=1.0)
    """largest measured speed, divided by the joint's speed limit (see `patience_ticks`)"""
    patience_ticks: int = Field(3, ge=0)
    """number of measurements in a row that may be missing or exceed `jump_rad` or `speed_factor`. They are replaced by
    extrapolation. One more stops the arm"""
    tip_error_m: float = Field(0.01, gt=0.0)
    """rms distance of the tip from its reference above which the arm is stopped"""
    tip_error_s: float = Field(0.1, gt=0.0, description="time constant of the mean square of the tip error")
    rcm_error_m: Level = 0.010
    """rms distance of the shaft from the registered trocar above which the arm is stopped"""
    rcm_warning_m: Level = 0.005
    """rms distance of the shaft from the registered trocar above which a warning is recorded"""
    trocar_force_N: Level = 15.0
    """rms force of the trocar on the shaft above which the arm is stopped"""
    trocar_force_warning_N: Level = 8.0
    """rms force across the shaft above which a warning is recorded. It includes loads and contacts at the tip"""
    tip_force_N: Level = 10.0
    """largest force across the shaft that is attributed to a contact at the tip. The rest counts as trocar force"""
    incision_s: float = Field(0.1, gt=0.0)
    """time constant of the mean squares of RCM error and trocar force"""
    stop_damping_Nm_s_per_rad: float = Field(20.0, gt=0.0, description="damping of the drives in a stop")
    stop_holding: float = Field(0.25, ge=0.0, le=1.0)
    """dry friction of the brakes in a stop, as a share of the largest torque. With 0, a load sinks"""
    stop_yield_N: Level = 8.0
    """trocar force above which the brakes open in a stop. They close at half of it"""
    stop_yield_s: float = Field(0.4, ge=0.0, le=60.0)
    """longest time for which the brakes stay open in a stop. They open again if the trocar force rises by
    `stop_yield_N`"""
    stop_s: float = Field(0.5, gt=0.0)
    """shortest time of a stop. The stop ends when the arm rests, at the latest after 4 times `stop_s`"""

    @model_validator(mode="after")
    def _warned_before_it_stops(self) -> Self:
        for warning, limit in (("rcm_warning_m", "rcm_error_m"), ("trocar_force_warning_N", "trocar_force_N")):
            low, high = getattr(self, warning), getattr(self, limit)
            if low is not None and high is not None and low > high:
                raise ValueError(f"{warning} = {low:g} is above {limit} = {high:g}: give {warning} at most {high:g}")
        return self
