"""The plant's end of the wire: a controller that is somewhere else, in the place of one that is here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from secrets import randbits
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.errors import MocOptError, printable
from moc_opt.inputs.files import parse_json
from moc_opt.realtime.clock import WallClock
from moc_opt.realtime.link import Link, WireError, WireSettings, written
from moc_opt.realtime.packets import ENDED, REPORTED, RUNNING, STOP, WAITING, Kind, Packet, make_packet
from moc_opt.sim.protocols import Filtered
from moc_opt.sim.sensors import Measurement
from moc_opt.trace.meta import check_entry

INCOMING = (Kind.HELLO, Kind.START, Kind.COMMAND, Kind.BYE)
_BYE_S, _BYE_TIMES = 0.1, 10


class RemoteController(Filtered):
    """Sends each measurement, and hands on the torque that comes back; without one, the watchdog's.

    Run it by ``sim.loop.simulate`` with ``pace`` as its ``watch``, and ``close`` it afterwards. docs/realtime.md has
    the watchdog's stages.

    Args:
        safety_filter: the plant's own, which knows the arm's weight and its brakes.
        columns: number of ticks -> the columns of the controller that is at the other end.
        applied: (n,) torque before the first tick [Nm].
        tau_max: (n,) largest torques [Nm]; a command beyond them counts as none.
        clock: None is lock-step: the plant waits for each command, and sends the measurement again where none comes.
    """

    stop_reason = ""

    def __init__(
        self, link: Link, settings: WireSettings, safety_filter: SafetyFilter,
        columns: Callable[[int], dict[str, NDArray[Any]]], applied: Array, tau_max: Array, scenario: int,
        clock: WallClock | None,
    ) -> None:  # fmt: skip
        self.link, self.clock, self._settings, self._filter = link, clock, settings, safety_filter
        self._make_columns, self._applied, self._tau_max = columns, applied, np.array(tau_max)
        self._packet = make_packet(Kind.MEASUREMENT, link.n, randbits(63) | 1, scenario)
        self._friction, self._tick, self._until, self._silent = np.zeros(link.n), 0, 0.0, 0
        self._command: Packet | None = None
        self._meta: dict[str, Any] = {}

    limited = property(lambda self: 0 if self._command is None else int(self._command["limited"]))
    warnings = property(lambda self: [])  # of the safety filter at the other end: see `close`

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Wait for a controller, show it the first measurement, and wait until it has started there.

        Raises:
            WireError: none came in time.
        """
        link, packet = self.link, self._packet
        self._sound = seen
        self._fill(seen, WAITING)

        def starts(found: Packet) -> bool:
            if found["kind"] == Kind.HELLO:
                link.send(packet, link.sender)
                return False
            begins = found["kind"] == Kind.START and found["session"] == packet["session"]
            link.quality["foreign"] += not begins
            return bool(begins)

        if link.receive(monotonic() + self._settings.wait_s, starts) is None:
            raise WireError(
                f"no controller came to {written(link.address)} within {self._settings.wait_s:g} s ({link.heard}): "
                "start `moc-opt control` on the same scenario with the same key, or raise [wire] wait_s"
            )
        link.peer, link.session = link.sender, int(packet["session"])

    def pace(self, tick: int) -> None:
        """Wait until a tick begins."""
        if self.clock is not None:
            self._until = self.clock.wait_for(tick)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Send a measurement, and return the torque (n,) [Nm] that came for it, or the watchdog's."""
        if np.isfinite(seen.q).all() and np.isfinite(seen.v).all():
            self._sound = seen
        braked = bool(self._filter.reason)
        self._command = command = None if braked else self._exchange(seen)
        self._missed = command is None and not braked
        self.link.quality["missed"] += self._missed
        if command is None:
            self._applied = self._without_command()
        else:
            self._silent, self._applied, self._friction = 0, np.array(command["tau"]), np.array(command["friction"])
            if int(command["flags"]) & STOP and not self.stop_reason:
                self.stop_reason = _text(command["reason"]) or "the controller asked for it"
        self._tick += 1
        return self._applied

    def _without_command(self) -> Array:
        """Return the watchdog's torque (n,) [Nm]: the one before, then weight and damping, then with closed brakes."""
        self._silent += 1
        safety, past, sound = self._filter, self._silent - self._settings.hold_ticks, self._sound
        if past <= 0:
            return self._applied
        if not safety.reason:
            safety.start(sound.q, sound.v, sound.stamp)  # the weight is that of this pose
            if past <= self._settings.damp_ticks:
                return safety.stop_torque(self._applied) - self._settings.damping_Nm_s_per_rad * sound.v
            safety.request_stop(f"no command from the controller for {self._silent} ticks")
            self.stop_reason = self.stop_reason or safety.reason
        self._friction = safety.brake_friction(sound.force)
        return safety.stop_torque(self._applied)

    def brake_friction(self, seen: Measurement) -> Array:
        """Return the dry friction (n,) [Nm] that came with the last command, or the watchdog's."""
        return self._friction

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the controller's columns, and those of the wire: lateness of the tick, the controller's own time."""
        return {
            **self._make_columns(ticks), "wake_us": np.full(ticks, np.nan), "control_us": np.full(ticks, np.nan),
            "missed": np.zeros(ticks, dtype=np.bool_),
        }  # fmt: skip

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the last tick's values into a row, the third level's where the command holds them."""
        command, columns["missed"][row] = self._command, self._missed
        if self.clock is not None:
            columns["wake_us"][row] = self.clock.late_us
        if command is None:
            return
        reported = int(command["flags"]) & REPORTED
        for name, column in columns.items():
            if name in (command.dtype.names or ()) and (reported or name == "control_us"):
                value = command[name]
                column[row] = _text(value) if value.dtype.kind == "S" else value

    def close(self) -> dict[str, Any]:
        """Tell the controller, once, that the run is over; return what the trace's meta gets: its words, and counts."""
        if self._meta:
            return self._meta
        self._packet["flags"], words = ENDED, ""

        def acknowledges(found: Packet) -> bool:
            self._is_due(found)  # counts commands that come now
            return bool(found["kind"] == Kind.BYE)

        for _ in range(_BYE_TIMES if self.link.session else 0):
            self.link.send(self._packet)
            if (found := self.link.receive(monotonic() + _BYE_S, acknowledges)) is not None:
                words = _text(found["words"])
                break
        self.link.close()
        counts = self.link.quality | ({} if self.clock is None else {"overruns": self.clock.overruns})
        self._meta = {**_told(words), "wire": counts}
        return self._meta

    def _fill(self, seen: Measurement, state: int) -> None:
        packet = self._packet
        packet["flags"], packet["sequence"], packet["stamp"] = state, self._tick, seen.stamp
        packet["q"], packet["v"], packet["wrench"], packet["commanded"] = seen.q, seen.v, seen.force, self._applied

    def _exchange(self, seen: Measurement) -> Packet | None:
        self._fill(seen, RUNNING)
        # A controller that missed a whole tick is asked once a tick: one that has died ends the run in seconds.
        for _ in range(1 if self.clock is not None or self._silent else 1 + self._settings.resends):
            self.link.send(self._packet)
            until = monotonic() + self._settings.resend_s if self.clock is None else self._until
            if (command := self.link.receive(until, self._is_due)) is not None:
                return command
        return None

    def _is_due(self, found: Packet) -> bool:
        """Say whether a packet is this tick's command and can be followed; count each command."""
        if found["kind"] != Kind.COMMAND:
            return False
        number, friction = int(found["sequence"]), found["friction"]
        usable = bool(
            number == self._tick and (np.abs(found["tau"]) <= self._tau_max).all()
            and found["limited"] <= self.link.n and ((friction >= 0.0) & (friction < np.inf)).all()
        )  # fmt: skip
        self.link.quality["received" if usable else "late" if number < self._tick else "foreign"] += 1
        return usable


def _text(field: NDArray[Any]) -> str:
    return printable(bytes(field[()]).decode(errors="replace"))


def _told(text: str) -> dict[str, Any]:
    try:
        found = parse_json(text, "last words of the controller", WireError) if text else {}
        names = ("faults", "restarts", "warnings")
        told = {name: found[name] for name in names if name in found and (found[name] or name == "faults")}
        for name, value in told.items():
            check_entry(name, value)
    except (MocOptError, TypeError):
        return {}  # of a controller that is not ours; the run is over, and its trace complete without
    return told
