"""The settings of a controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from moc_opt.arrays import Array
from moc_opt.control.presets import PRESETS as PRESETS
from moc_opt.control.supervisor import SupervisorSettings
from moc_opt.errors import ControlError, MocOptError, UnknownNameError
from moc_opt.inputs.settings import LARGEST, Settings

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


def _number_or_numbers(value: Any) -> float | tuple[float, ...]:
    numbers = value if isinstance(value, list | tuple) else (value,)
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, int | float) or not 0.0 <= number <= LARGEST:
            raise ValueError("input should be a number of 0 or more, or a list with one for each joint")
    return float(value) if numbers is not value else tuple(float(number) for number in numbers)


PerJoint = Annotated[float | tuple[float, ...], BeforeValidator(_number_or_numbers)]
"""One number for all joints, or one per joint."""


class Gains(NamedTuple):
    """The gains of the three levels."""

    K_X: float  #: [N/m]
    D_X: float  #: [N s/m]
    K_N: float  #: [N/m]
    D_N: float  #: [N s/m]
    K_N2: Array  #: (n,) [N m s/rad]; zero under law ``dcac``.
    D_N2: Array  #: (n,) [N m s/rad]; zero under law ``dcac``.


GAINS = Gains._fields


class ControlSettings(Settings):
    """The control law. Level 3 makes the joint velocity v follow x, the velocity that its solver computes in the box.

    The tables [gains.dcac] and [gains.moc] in the robots' files are from Table I of Su et al. (2019).
    """

    KIND: ClassVar[str] = "[control]"
    MORE_KEYS: ClassVar[tuple[str, ...]] = ("preset",)
    ERROR: ClassVar[type[MocOptError]] = ControlError

    law: Literal["dcac", "moc"] = "moc"
    """'dcac': only level 1 (tip) and level 2 (RCM); 'moc': also level 3, which raises the manipulability mu"""
    gains: str | None = "default"
    """name of the table of default gains in the robot's file (such as moc_opt/robots/lwr4.toml). '': the law's name"""
    K_X: Positive | None = Field(default=None, description="tip stiffness [N/m]; default: see gains (3000 for lwr4)")
    D_X: NotNegative | None = Field(default=None, description="tip damping [N s/m]; default: see gains")
    K_N: Positive | None = Field(default=None, description="wrist stiffness [N/m]; default: see gains")
    D_N: NotNegative | None = Field(default=None, description="wrist damping [N s/m]; default: see gains")
    K_N2: PerJoint | None = Field(default=None, description="gain of level 3 on x - v [N m s/rad]; default: see gains")
    D_N2: PerJoint | None = Field(default=None, description="gain of level 3 on -v [N m s/rad]; default: see gains")
    dcac_damping: PerJoint = 0.0
    """law 'dcac': damping of elbow motion that leaves tip and wrist at rest [N m s/rad]. 0 in the paper"""
    rcm_lambda: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    """if given, the wrist's error is taken as d / rcm_lambda, with the RCM error d. If left out, the true error of the
    wrist is used. 0.5 in the paper"""
    projector: Literal["dynamic", "static", "as_published"] = "dynamic"
    """null-space projector of level 2. docs/method.md explains the choices"""
    feedforward: bool = True
    """whether the desired accelerations of tip and wrist are fed forward. false in the paper"""
    observer_gain_per_s: NotNegative = 20.0
    """gain of the momentum observer, which estimates external torques. 0: no observer. If the elbow follows a course,
    course_observer_gain_per_s replaces a gain above 0 (see third_level)"""
    limit_torque: bool = True
    """whether the controller limits each torque to the joint's largest torque"""
    k0_per_s: Positive = 2.0
    """the box allows at most the speed k0 d towards a joint limit, where d is the distance to the limit minus
    limit_margin_rad. 0.1 in the paper. If the elbow follows a course, k0 is at least 10 (see third_level)"""
    third_level: Literal["local", "planned", "receding"] = "local"
    """motion of the elbow under law 'moc'. 'local': in the direction in which mu rises; 'planned': along a course
    (planned joint motion) computed before the run; 'receding': along a course that is replanned during the run"""
    course: str = ""
    """with third_level 'planned': file of the course, written by `moc-opt plan --out`. A relative path starts at the
    scenario's folder. If empty, a course is planned before the run"""
    horizon_s: Annotated[float, Field(ge=0.2, le=2.0)] = 1.0
    """with third_level 'receding': duration of each replanned course"""
    replan_per_s: Annotated[float, Field(ge=20.0, le=50.0)] = 20.0
    """with third_level 'receding': number of courses computed per second"""
    course_speed_fraction: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.85
    """largest speed of a joint in a course, as a share of the joint's largest speed v_max. A course may be up to 1.12
    times as fast if mu then rises by more than 1 %. The rest of v_max lets a lagging arm catch up"""
    course_margin_rad: NotNegative = 0.05
    """distance that a course keeps from joint limits. At this distance, the box allows no speed towards the limit. If
    no course with this distance reaches the end of the path, a course may come nearer"""
    course_observer_gain_per_s: NotNegative = 40.0
    """observer gain if the elbow follows a course. The elbow then moves faster, and needs a faster observer"""
    climb: Literal["gradient", "scaled"] = "gradient"
    """with third_level 'local': speed of the elbow. 'gradient': proportional to the gradient of mu; 'scaled': Newton's
    step to the nearest maximum of mu, at most 1 rad, divided by 0.2 s"""
    c0: NotNegative = Field(default=0.01, description="weight of the tip velocity in the subproblem's cost")
    c1: NotNegative = Field(default=0.01, description="weight of the wrist velocity in the subproblem's cost")
    c2: NotNegative = Field(default=0.001, description="weight of the gradient of mu in the subproblem's cost")
    regularization: NotNegative = 1e-5
    """weight rho of |x|^2 / 2 in the subproblem's cost. 0 in the paper: if A x = b, the cost is then linear in x"""
    fallback: Literal["damping", "hold", "least-violation"] = "least-violation"
    """x that is used if the solver finds no x in the box with A x = b. 'damping': no self-motion (elbow motion with tip
    and wrist at rest); 'hold': the last good answer; 'least-violation': the x in the box with the smallest |A x - b|"""
    speed_fraction: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    """with third_level 'local': largest speed in the box, as a share of the joint's v_max. 1 in the paper"""
    limit_margin_rad: NotNegative = 0.15
    """with third_level 'local': at this distance from a joint limit, x must not lead to the limit. 0 in the paper"""
    limit_margin_m: NotNegative = Field(default=0.05, description="margin of sliding joints with any third_level")
    shaft_margin: float = Field(default=0.175, ge=0.0, le=1.0)
    """threshold that keeps the arm off poses in which the joints can hardly turn the shaft. Let s be the manipulability
    of the shaft with the tip at rest, divided by the squared distance from wrist to tip. If s is below the
    threshold, third_level 'local' also raises s. The box then grows as s falls. If s is two thirds of the
    threshold, the box reaches v_max. If possible, a course keeps s above a quarter of the threshold. 0 in the paper"""
    ramp_s: NotNegative = 0.3
    """time in which level 3's torque rises to its full size at the start of the run. 0 in the paper"""
    supervisor: SupervisorSettings = SupervisorSettings()

    @field_validator("gains", mode="before")
    @classmethod
    def _name_of_a_table(cls, given: Any) -> Any:
        if isinstance(given, Mapping):
            raise ValueError(  # noqa: TRY004 - pydantic names the field only for a ValueError
                "give the name of a table of the robot's file; single gains are keys of [control] itself"
            )
        return None if given == "" else given  # TOML has no None

    @model_validator(mode="after")
    def _in_agreement(self) -> Self:
        if self.course and self.third_level != "planned":
            raise ValueError(
                f"course = {self.course!r:.100} with third_level = {self.third_level!r}: only third_level = 'planned' "
                "follows a file; set that, or leave course out"
            )
        if self.law == "dcac" and self.follows:
            raise ValueError(
                f"law = 'dcac' with third_level = {self.third_level!r}: dcac has no third level; "
                "take law = 'moc', or leave third_level out"
            )
        return self

    @classmethod
    def preset(cls, name: str, **changes: Any) -> ControlSettings:
        """Return a named set of settings, with ``changes`` to some of its fields.

        Raises:
            UnknownNameError: there is no such preset.
        """
        if name not in PRESETS:
            raise UnknownNameError("control preset", name, PRESETS)
        return cls(**{**PRESETS[name], **changes})

    def check_guided(self) -> None:
        """Raise a ControlError unless regularization and c2 are above 0."""
        if not min(self.regularization, self.c2) > 0.0:
            raise ControlError(
                f"third_level = {self.third_level!r}, climb = {self.climb!r} with c2 = {self.c2:g}, regularization = "
                f"{self.regularization:g}: set both above 0, so that the subproblem has one answer"
            )

    def matched_dcac(self) -> dict[str, Any]:
        """Return the changes that turn these settings into DCAC with the same gains."""
        return {
            "law": "dcac", "gains": self.gains or self.law, "third_level": "local", "course": "",
            "observer_gain_per_s": self.observer_rate_per_s,
        }  # fmt: skip

    @property
    def follows(self) -> bool:
        """Whether the third level follows a course (planned joint motion)."""
        return self.third_level != "local"

    @property
    def observer_rate_per_s(self) -> float:
        """Gain of the momentum observer in use; 0: no observer."""
        if self.follows and self.observer_gain_per_s > 0.0:
            return self.course_observer_gain_per_s
        return self.observer_gain_per_s

    def resolve_gains(self, tables: Mapping[str, Mapping[str, Any]], joints: int) -> Gains:
        """Return the gains. Gains that are not set come from the robot's ``tables`` [gains.*].

        Raises:
            UnknownNameError: ``gains`` is no table of this robot.
            ControlError: a gain is missing or does not fit the joints.
        """
        name = self.gains or self.law
        if name not in tables:
            raise UnknownNameError("table of gains", name, tables)
        found: dict[str, Any] = {"K_N2": np.zeros(joints), "D_N2": np.zeros(joints)}
        for gain in GAINS if self.law == "moc" else GAINS[:4]:
            own = getattr(self, gain)
            value, where = (tables[name].get(gain), f" in [gains.{name}] of the robot") if own is None else (own, "")
            if value is None:
                raise ControlError(f"{gain}: not set, and [gains.{name}] of the robot has none; give a number")
            if gain in found:
                found[gain] = per_joint(gain + where, value, joints)
            elif isinstance(value, int | float):
                found[gain] = float(value)
            else:
                raise ControlError(f"{gain}{where} = {value!r}: give one number")
        return Gains(**found)


def per_joint(name: str, value: Any, joints: int) -> Array:
    """Return (n,) from one number for all joints, or one per joint. Raise a ControlError for any other count."""
    if not isinstance(value, int | float) and len(value) != joints:
        count = f"{len(value)} entries for {joints} joints"
        raise ControlError(f"{name} = {value!r} has {count}: give one number, or one per joint")
    return np.broadcast_to(np.asarray(value, dtype=np.float64), joints).copy()
