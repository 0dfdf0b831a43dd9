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
            raise ValueError("input should be a number of 0 or more, or a list of such numbers, one per joint")
    return float(value) if numbers is not value else tuple(float(number) for number in numbers)


PerJoint = Annotated[float | tuple[float, ...], BeforeValidator(_number_or_numbers)]
"""One number for all joints, or one per joint."""


class Gains(NamedTuple):
    """The gains of the three levels."""

    K_X: float  #: Level 1: tip stiffness [N/m].
    D_X: float  #: Level 1: tip damping [N s/m].
    K_N: float  #: Level 2: wrist stiffness [N/m].
    D_N: float  #: Level 2: wrist damping [N s/m].
    K_N2: Array  #: (n,) level 3: gain on (solver's velocity x) - v [N m s/rad]; 0 under law ``dcac``.
    D_N2: Array  #: (n,) level 3: damping gain on v [N m s/rad]; 0 under law ``dcac``.


GAINS = Gains._fields


class ControlSettings(Settings):
    """The control law. Level 1 moves the tip, level 2 the wrist, and level 3 the elbow. x is level 3's joint velocity.

    The tables [gains.dcac] and [gains.moc] in the robots' files are from Table I of Su et al. (2019).
    """

    KIND: ClassVar[str] = "[control]"
    MORE_KEYS: ClassVar[tuple[str, ...]] = ("preset",)
    ERROR: ClassVar[type[MocOptError]] = ControlError

    law: Literal["dcac", "moc"] = "moc"
    """control law. 'dcac': levels 1 and 2 (tip and RCM); 'moc': also level 3, which raises the manipulability"""
    gains: str | None = "default"
    """name of a table [gains.NAME] in the robot's file. It gives those of `K_X`, `D_X`, `K_N`, `D_N`,
    `K_N2` and `D_N2` that are not set here. '': the table with the name of `law`"""
    K_X: Positive | None = Field(None, description="tip stiffness [N/m]")
    D_X: NotNegative | None = Field(None, description="tip damping [N s/m]")
    K_N: Positive | None = Field(None, description="wrist stiffness [N/m]")
    D_N: NotNegative | None = Field(None, description="wrist damping [N s/m]")
    K_N2: PerJoint | None = None
    """level 3: gain on the difference between the solver's and the measured joint velocity [N m s/rad]"""
    D_N2: PerJoint | None = None
    """level 3: damping gain on the measured joint velocity [N m s/rad]"""
    dcac_damping: PerJoint = 0.0
    """damping of elbow motion under `law` = 'dcac' [N m s/rad]"""
    rcm_lambda: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    """assumed ratio of RCM error to wrist error, as in the paper. K_N acts on the wrist error. If `rcm_lambda` is
    given, RCM error / `rcm_lambda` replaces the length of the wrist error"""
    projector: Literal["dynamic", "static", "as_published"] = "dynamic"
    """null-space projector of level 2. 'dynamic': dynamically consistent; 'static': statically consistent;
    'as_published': as printed in Su et al. (2019)"""
    feedforward: bool = True
    """whether the desired accelerations of tip and wrist are fed forward"""
    observer_gain_per_s: NotNegative = 20.0
    """gain of the momentum observer, which estimates external torques. 0: no observer. With `third_level` 'planned' or
    'receding', a gain above 0 is replaced by `course_observer_gain_per_s`"""
    limit_torque: bool = True
    """whether the controller limits each torque to the joint's largest torque"""
    k0_per_s: Positive = 2.0
    """k0 in the bound v <= k0 d on level 3. v is a joint's speed towards a joint limit. d is the joint's distance from
    this limit, minus its margin (`limit_margin_rad`, `limit_margin_m` or `course_margin_rad`). With `third_level`
    'planned' or 'receding', 10 replaces a smaller `k0_per_s`"""
    third_level: Literal["local", "planned", "receding"] = "local"
    """motion of the elbow under `law` = 'moc'. 'local': up the gradient of the manipulability; 'planned': along a joint
    motion that is planned before the run; 'receding': along a joint motion that is replanned during the run"""
    course: str = ""
    """file of `moc-opt plan --out`, for `third_level` 'planned'. If empty, the motion is planned before the run"""
    horizon_s: Annotated[float, Field(ge=0.2, le=2.0)] = 1.0
    """planning horizon of `third_level` 'receding'"""
    replan_per_s: Annotated[float, Field(ge=20.0, le=50.0)] = 20.0
    """planning rate of `third_level` 'receding'"""
    course_speed_fraction: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.85
    """largest joint speed of a planned motion, as a share of the joint's speed limit. The rest of the joint's speed
    lets a lagging arm catch up"""
    course_margin_rad: NotNegative = 0.05
    """distance that a planned motion keeps from the limits of revolute joints. If no motion keeps it, 0 replaces it"""
    course_observer_gain_per_s: NotNegative = 40.0
    """gain of the momentum observer with `third_level` 'planned' or 'receding'"""
    climb: Literal["gradient", "scaled"] = "gradient"
    """elbow speed with `third_level` 'local'. 'gradient': proportional to the gradient of the manipulability; 'scaled':
    Newton step towards a maximum of the manipulability, divided by 0.2 s"""
    c0: NotNegative = Field(0.01, description="weight of the tip velocity's error in the solver's cost")
    c1: NotNegative = Field(0.01, description="weight of the wrist velocity's error in the solver's cost")
    c2: NotNegative = Field(0.001, description="weight of the manipulability gradient in the solver's cost")
    regularization: NotNegative = 1e-5
    """weight of |x|^2 / 2 in the solver's cost, for the joint velocity x. With 0, x can jump between bounds"""
    fallback: Literal["damping", "hold", "least-violation"] = "least-violation"
    """joint velocity x if no x within its bounds gives tip and wrist their reference velocities (A x = b). 'damping':
    x = 0; 'hold': the last good answer; 'least-violation': an x within the bounds with the smallest |A x - b|"""
    speed_fraction: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    """largest joint speed with `third_level` 'local', as a share of the joint's speed limit"""
    limit_margin_rad: NotNegative = 0.15
    """distance from a revolute joint's limit at which `third_level` 'local' stops moving the joint towards this limit.
    With 'planned' and 'receding', `course_margin_rad` replaces it"""
    limit_margin_m: NotNegative = 0.05
    """like `limit_margin_rad`, for prismatic joints and with every `third_level`"""
    shaft_margin: float = Field(default=0.175, ge=0.0, le=1.0)
    """threshold of m / L^2, where m is the wrist's manipulability while the tip is held (docs/method.md) and L the
    distance from wrist to tip. Below the threshold, `third_level` 'local' also raises m. 0 switches this off"""
    ramp_s: NotNegative = 0.3
    """time in which the torque of level 3 rises to full size at the start"""
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
                "follows a file; set this third_level, or omit course"
            )
        if self.law == "dcac" and self.follows:
            raise ValueError(
                f"law = 'dcac' with third_level = {self.third_level!r}: dcac has no third level; "
                "use law = 'moc', or omit third_level"
            )
        return self

    @classmethod
    def preset(cls, name: str, **changes: Any) -> ControlSettings:
        """Return a named set of settings, in which ``changes`` replace some fields.

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
                f"{self.regularization:g}: set c2 and regularization above 0, so that the subproblem has one answer"
            )

    def matched_dcac(self) -> dict[str, Any]:
        """Return the changes that give these settings the law ``dcac``, with the same gains and observer."""
        return {
            "law": "dcac", "gains": self.gains or self.law, "third_level": "local", "course": "",
            "observer_gain_per_s": self.observer_rate_per_s,
        }  # fmt: skip

    @property
    def follows(self) -> bool:
        """Whether level 3 follows a course (a planned joint motion)."""
        return self.third_level != "local"

    @property
    def observer_rate_per_s(self) -> float:
        """Gain of the momentum observer under this ``third_level`` [1/s]; 0: no observer."""
        if self.follows and self.observer_gain_per_s > 0.0:
            return self.course_observer_gain_per_s
        return self.observer_gain_per_s

    def resolve_gains(self, tables: Mapping[str, Mapping[str, Any]], joints: int) -> Gains:
        """Return the gains for n = ``joints``. A gain that is not set comes from one of the robot's ``tables``.

        Raises:
            UnknownNameError: ``gains`` names no table of this robot.
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
    """Return one number per joint. Raise a ControlError if ``value`` is a sequence of another length."""
    if not isinstance(value, int | float) and len(value) != joints:
        count = f"{len(value)} entries for {joints} joints"
        raise ControlError(f"{name} = {value!r} has {count}: give one number, or one per joint")
    return np.broadcast_to(np.asarray(value, dtype=np.float64), joints).copy()
