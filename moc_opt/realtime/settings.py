"""``[wire]`` of a scenario: what the plant does without commands, and how long either end waits."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from moc_opt.errors import MocOptError
from moc_opt.inputs.settings import Settings
from moc_opt.realtime.key import WireError


class WireSettings(Settings):
    """The plant's watchdog, and time-outs."""

    KIND: ClassVar[str] = "[wire]"
    ERROR: ClassVar[type[MocOptError]] = WireError

    hold_ticks: int = Field(5, ge=0, description="ticks in a row without a command for which the last torque is held")
    damp_ticks: int = Field(
        50, ge=0, description="ticks after those, with gravity compensation and damping, before the brakes close"
    )
    damping_Nm_s_per_rad: float = Field(5.0, gt=0.0, le=1e3, description="damping of every joint in those ticks")
    wait_s: float = Field(60.0, gt=0.0, description="time for which either end waits for the other one to start")
    silence_s: float = Field(5.0, gt=0.0, description="time without a measurement after which the controller gives up")
    resend_s: float = Field(0.2, gt=0.0, description="lock-step: time after which a measurement is sent again")
    resends: int = Field(
        20, ge=0, description="lock-step: number of times a measurement is sent again; then the tick counts as missed"
    )
