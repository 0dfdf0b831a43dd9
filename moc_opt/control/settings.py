"""What a controller can be told. Gains that are left out come from the robot's own table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from moc_opt.control.supervisor import SupervisorSettings
from moc_opt.errors import ControlError, MocOptError, UnknownNameError
from moc_opt.settings import Settings

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]

GAINS = ("K_X", "D_X", "K_N", "D_N", "K_N2", "D_N2")
PRESETS = ("paper", "tuned")

# No observer, no ramp, and a box that goes up to the limits of the joints themselves.
PAPER: dict[str, Any] = {
    "k0_per_s": 0.1,
    "damping": 0.0,
    "observer_gain_per_s": 0.0,
    "speed_fraction": 1.0,
    "limit_margin_rad": 0.0,
    "ramp_s": 0.0,
}

# Found by: python -m benchmarks.tune --seed 0, for the LWR4+ in the realistic plant. Then D_X came down from 80 (the
# table's), K_N2 from 22.9, the observer from 33.3: every goal is still reached, and the loop bears four ticks of delay.
TUNED: dict[str, Any] = {
    "gains": "moc",
    "D_X": 50.0,
    "K_N": 1670.0,
    "D_N": 74.2,
    "K_N2": 15.0,
    "D_N2": 2.0,
    "observer_gain_per_s": 22.0,
    "feedforward": True,
    "k0_per_s": 1.58,
    "damping": 3.24e-5,
    "speed_fraction": 0.49,
    "ramp_s": 0.653,
}


class ControlSettings(Settings):
    """The stack of three levels.

    ``law``: ``dcac`` is tip and RCM alone, ``moc`` adds the third level. ``gains`` names the table
    of the robot's TOML to start from (``dcac`` or ``moc``; the law's own when None), so that both
    laws can run with matched gains.
    """

    KIND: ClassVar[str] = "[control]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    law: Literal["dcac", "moc"] = "moc"
    gains: str | None = None
    K_X: Positive | None = Field(default=None, description="tip stiffness [N/m]")
    D_X: NotNegative | None = Field(default=None, description="tip damping [N s/m]")
    K_N: Positive | None = Field(default=None, description="wrist stiffness [N/m]")
    D_N: NotNegative | None = Field(default=None, description="wrist damping [N s/m]")
    K_N2: NotNegative | None = Field(default=None, description="third level, on x* - v [N m s/rad]")
    D_N2: NotNegative | None = Field(default=None, description="third level, on v [N m s/rad]")
    dcac_damping: NotNegative = Field(
        default=0.0, description="damping of the self-motion under dcac; 0 as in the paper"
    )

    projector: Literal["dynamic", "static", "printed"] = "dynamic"
    feedforward: bool = Field(default=False, description="acceleration feed-forward of tip and wrist")
    observer_gain_per_s: NotNegative = Field(default=20.0, description="momentum observer; 0 switches it off")
    limit_torque: bool = True

    k0_per_s: Positive = Field(default=2.0, description="velocity damper; the paper has 0.1")
    c0: NotNegative = 0.01
    c1: NotNegative = 0.01
    c2: NotNegative = 0.001
    damping: NotNegative = Field(default=1e-5, description="rho; 0 is the paper's linear problem")
    fallback: Literal["damping", "hold", "least-violation"] = Field(
        default="damping", description="the answer to an infeasible subproblem"
    )
    speed_fraction: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.5, description="of v_max in the box on x: limits how fast the elbow travels; the paper has 1"
    )
    limit_margin_rad: NotNegative = Field(
        default=0.045, description="the box on x closes this far inside a joint limit; 0, at it, is the paper's"
    )
    ramp_s: NotNegative = Field(
        default=0.3, description="the third level fades in over this time [s]; the paper has 0"
    )
    supervisor: SupervisorSettings = SupervisorSettings()
    backend: Literal["python", "c"] = Field(
        default="python", description="'c' compiles the whole tick; solver 'exact' only"
    )

    @classmethod
    def paper(cls, **changes: Any) -> ControlSettings:
        """The paper's parameters where it prints them, and nothing that it does not have; see ``PAPER``."""
        return cls(**{**PAPER, **changes})

    @classmethod
    def tuned(cls, **changes: Any) -> ControlSettings:
        """What ``python -m benchmarks.tune`` found for the LWR4+ in the realistic plant; see ``TUNED``."""
        return cls(**{**TUNED, **changes})

    @classmethod
    def preset(cls, name: str, **changes: Any) -> ControlSettings:
        """A named set of settings; ``changes`` override fields.

        Raises:
            UnknownNameError: no such preset; the message lists them.
        """
        if name not in PRESETS:
            raise UnknownNameError("control preset", name, PRESETS)
        make: Callable[..., ControlSettings] = getattr(cls, name)
        return make(**changes)

    def resolve_gains(self, tables: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
        """K_X .. D_N2 as numbers: settings first, then the robot's table.

        Raises:
            UnknownNameError: ``gains`` names no table of this robot.
            ControlError: a gain that this law needs stands nowhere, or the robot's is no number of 0 or more.
        """
        name = self.gains or self.law
        if name not in tables:
            raise UnknownNameError("table of gains", name, tables)
        found = {gain: getattr(self, gain) for gain in GAINS}
        found = {gain: tables[name].get(gain) if value is None else value for gain, value in found.items()}
        needed = GAINS if self.law == "moc" else GAINS[:4]
        for gain in needed:
            if found[gain] is None:
                raise ControlError(
                    f"{gain}: not set, and [gains.{name}] of the robot has none; give a number"
                )
            if not isinstance(found[gain], int | float) or not 0.0 <= found[gain] < float("inf"):
                raise ControlError(
                    f"{gain} = {found[gain]!r} in [gains.{name}] of the robot: give one number of 0 or more"
                )
        return {gain: float(found[gain]) if gain in needed else 0.0 for gain in GAINS}
