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
        50, ge=0, description="ticks after those with gravity compensation and damping, before the brakes close"
    )
    damping_Nm_s_per_rad: float = Field(5.0, gt=0.0, le=1e3, description="of every joint meanwhile")
    wait_s: float = Field(60.0, gt=0.0, description="how long either end waits for the other one to begin")
    silence_s: float = Field(5.0, gt=0.0, description="without a measurement for so long, the controller gives up")
    resend_s: float = Field(0.2, gt=0.0, description="lock-step: a measurement is sent again after this time")
    resends: int = Field(20, ge=0, description="lock-step: so often; then the tick counts as missed")
