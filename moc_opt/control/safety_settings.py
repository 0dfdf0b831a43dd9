"""Settings of the safety filter: the table ``[guard]`` of a scenario."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from moc_opt.errors import ControlError, MocOptError
from moc_opt.inputs.settings import Level, Settings


class SafetyFilterSettings(Settings):
    """Limits of the safety filter, and its actions in a stop. Unless stated otherwise, exceeded limits stop the arm."""

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    motion: bool = True
    """whether measurements are checked: their age, repetitions, and whether positions, velocities and torques agree"""
    motion_s: float = Field(0.1, gt=0.0)
    """time over which the change of a joint's position is compared with the integral of its velocity"""
    motion_rad: float = Field(0.001, gt=0.0)
    """largest difference between a joint's change of position and the integral of its velocity, if the joint rests"""
    motion_lag_s: float = Field(0.012, ge=0.0)
    """assumed lag of measured velocities. If a joint's largest recent speed is v, v times the lag is added to
    `motion_rad`. A scenario raises the lag to at least three time constants of its velocity filter"""
    repeat_m: float = Field(0.003, gt=0.0)
    """largest travel of the tip's reference while all encoders repeat their readings"""
    repeat_torque: float = Field(0.06, gt=0.0)
    """largest change of a joint's torque while all encoders repeat their readings, as a share of the joint's torque
    limit. A scenario raises the share to at least 500 times `encoder_resolution_rad`"""
    repeat_whole_torque: float = Field(0.0005, gt=0.0)
    """replaces `repeat_torque` while the wrench sensor repeats its readings as well"""
    repeat_whole_m: float = Field(0.0005, gt=0.0)
    """replaces `repeat_m` while the wrench sensor repeats its readings as well"""
    repeat_whole_ticks: int = Field(25, ge=1)
    """largest number of consecutive control periods in which a noisy wrench sensor repeats its reading. The same
    limit holds for a replay: the number of measurements in a row that equal those taken a fixed time earlier"""
    stuck_torque: float = Field(0.06, ge=0.0)
    """assumed static friction of a joint, as a share of its torque limit; `stuck_rad_per_s` tells where it is used"""
    stuck_friction: float = Field(6.0, gt=0.0)
    """assumed static friction of a joint, as a multiple of its Coulomb friction in the robot's file. The smaller one of
    this friction and that of `stuck_torque` is used. If the Coulomb friction is 0 (unknown), `stuck_torque` counts"""
    repeat_joint_ticks: int | None = Field(None, ge=1)
    """largest number of consecutive control periods in which one encoder repeats its position. By default, the
    scenario computes it from the encoders' noise and step"""
    repeat_reading_ticks: int | None = Field(None, ge=0)
    """largest total number of control periods of a run in which one encoder repeats both its position and its velocity.
    By default, it is `patience_ticks` if noise and a velocity filter rule out such repetitions, else unlimited"""
    stuck_rad_per_s: float = Field(0.2, gt=0.0)
    """largest computed speed that a joint gains while its encoder repeats its reading. The computation uses the joint's
    inertia and the torque change beyond static friction (`stuck_torque`). A scenario raises the limit to at least
    600 times `encoder_resolution_rad`"""
    residual_torque: float = Field(0.2, gt=0.0)
    """largest difference of a joint's momentum residual from the residual's running mean, as a share of the torque
    limit. The residual is the torque implied by the joint's motion, minus the command. More than `patience_ticks`
    control periods in a row above the limit stop the arm"""
    residual_whole_torque: float = Field(0.5, gt=0.0)
    """like `residual_torque`, but for the momentum residual itself, from which no mean is subtracted"""
    residual_rate_per_s: float = Field(40.0, gt=0.0, lt=500.0)
    """gain of the observer that estimates the momentum residuals"""
    residual_s: float = Field(0.25, gt=0.0)
    """time constant of the running mean in `residual_torque`"""
    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="rate of change to which a torque is limited")
    position_margin_rad: float = Field(0.045, ge=0.0)
    """distance of the virtual wall (a spring) from a revolute joint's limit"""
    position_margin_m: float = Field(0.045, ge=0.0)
    """distance of the virtual wall (a spring) from a prismatic joint's limit"""
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0)
    """stiffness of the virtual wall (prismatic joints: N/m)"""
    wall_damping_Nm_s_per_rad: float = Field(20.0, ge=0.0)
    """damping of a joint's speed above the allowed speed, see `wall_brake_rad_per_s2` (prismatic joints: N s/m)"""
    wall_brake_rad_per_s2: float = Field(2.0, gt=0.0)
    """deceleration a before the virtual wall. At the distance d from the wall, the allowed speed towards the
    wall is the smaller one of sqrt(2 a d) and the joint's speed limit. A faster joint is damped"""
    jump_rad: float = Field(0.05, gt=0.0)
    """most that a measured position may change beyond the travel at the joint's speed limit; see `patience_ticks`"""
    speed_factor: float = Field(5.0, gt=1.0)
    """largest measured speed, divided by the joint's speed limit; see `patience_ticks`"""
    patience_ticks: int = Field(3, ge=0)
    """number of measurements in a row that may be missing or exceed `jump_rad` or `speed_factor`. Their
    positions are replaced by extrapolation. One more stops the arm"""
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
    """dry friction of the brakes in a stop, as a share of each joint's torque limit. With 0, a load sinks"""
    stop_yield_N: Level = 8.0
    """trocar force above which the brakes open in a stop. They close again at half of this force"""
    stop_yield_s: float = Field(0.4, ge=0.0, le=60.0)
    """longest time for which the brakes stay open in a stop. Brakes that close after this time open again only if
    the trocar force rises by `stop_yield_N` above its smallest value since then"""
    stop_s: float = Field(0.5, gt=0.0)
    """shortest time of a stop. After it, the stop ends when the arm rests, at the latest after 4 times `stop_s`"""

    @model_validator(mode="after")
    def _warned_before_it_stops(self) -> Self:
        for warning, limit in (("rcm_warning_m", "rcm_error_m"), ("trocar_force_warning_N", "trocar_force_N")):
            low, high = getattr(self, warning), getattr(self, limit)
            if low is not None and high is not None and low > high:
                raise ValueError(f"{warning} = {low:g} is above {limit} = {high:g}: give {warning} at most {high:g}")
        return self
