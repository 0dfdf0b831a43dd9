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
from moc_opt.realtime.link import BACKLOG, Link, WireError, WireSettings, written
from moc_opt.realtime.packets import ENDED, REPORTED, RUNNING, STOP, WAITING, Kind, Packet
from moc_opt.sim.protocols import Filtered
from moc_opt.sim.sensors import Measurement
from moc_opt.trace.meta import check_entry

Columns = Mapping[str, NDArray[Any]]

INCOMING = (Kind.HELLO, Kind.START, Kind.COMMAND, Kind.REPORT, Kind.BYE)
_BYE_S, _BYE_TIMES = 0.1, 10


class Watchdog:
    """Counts ticks without a command, and says which torque takes its place.

    The last torque is held for ``hold_ticks``. For ``damp_ticks`` more the drives carry the arm's weight and damp its
    motion; a command in that time is followed again. Then the brakes close, and nothing opens them.
    """

    def __init__(self, settings: WireSettings, safety_filter: SafetyFilter, first: Measurement) -> None:
        self._settings, self._filter, self._sound = settings, safety_filter, first
        self.missed = 0
        self.reason = ""

    def see(self, seen: Measurement) -> None:
        """Take note of a measurement; one that is not finite is passed over."""
        if np.isfinite(seen.q).all() and np.isfinite(seen.v).all():
            self._sound = seen

    def tick(self, applied: Array) -> Array:
        """Return the torque (n,) [Nm] of a tick without a command, where ``applied`` (n,) acted in the last one."""
        self.missed += 1
        past = self.missed - self._settings.hold_ticks
        if self.reason:
            return self._filter.stop_torque(applied)
        if past <= 0:
            return applied
        sound = self._sound
        self._filter.start(sound.q, sound.v, sound.stamp)  # the weight is that of this pose
        if past <= self._settings.damp_ticks:
            return self._filter.stop_torque(applied) - self._settings.damping_Nm_s_per_rad * sound.v
        self.reason = f"no command from the controller for {self.missed} ticks"
        self._filter.request_stop(self.reason)
        return self._filter.stop_torque(applied)

    def brake_friction(self) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes, once a tick."""
        return self._filter.brake_friction(self._sound.force)


class RemoteController(Filtered):
    """Sends each measurement, and hands on the torque that comes back; without one, the watchdog's.

    Run it by ``sim.loop.simulate`` with ``pace`` as its ``watch``, and ``close`` it afterwards.

    Args:
        link: listens at the plant's address.
        settings: watchdog and time-outs.
        safety_filter: the plant's own, which knows the arm's weight and its brakes.
        columns: number of ticks -> the columns of the controller that is at the other end.
        applied: (n,) torque before the first tick [Nm].
        tau_max: (n,) largest torques [Nm]: a command beyond them is not followed, like one that did not come.
        scenario: fingerprint of the settings that both ends must share.
        clock: keeps the time; None is lock-step: the plant waits for each command, and sends the measurement again
            where none comes.
    """

    stop_reason = ""
    limited = 0

    def __init__(
        self, link: Link, settings: WireSettings, safety_filter: SafetyFilter,
        columns: Callable[[int], dict[str, NDArray[Any]]], applied: Array, tau_max: Array, scenario: int,
        clock: WallClock | None,
    ) -> None:  # fmt: skip
        self.link, self.clock, self._settings, self._filter = link, clock, settings, safety_filter
        self._make_columns, self._applied, self._tau_max = columns, applied, np.array(tau_max)
        self._packet = Packet(Kind.MEASUREMENT, link.n, randbits(63) | 1, scenario)
        self._friction, self._tick, self._until = np.zeros(link.n), 0, 0.0
        self._newest, self._reported = {Kind.COMMAND: -1, Kind.REPORT: -1}, False
        self._columns: Columns = {}
        self._control_us, self._missed = float("nan"), False
        self.told: dict[str, Any] = {}
        self._counts: dict[str, Any] = {}

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """None: the controller's safety filter is at the other end; see ``told``, after ``close``."""
        return []

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Wait for a controller, show it the first measurement, and wait until it has started there.

        Raises:
            WireError: none came in time.
        """
        link, packet = self.link, self._packet
        self._watchdog = Watchdog(self._settings, self._filter, seen)
        until = monotonic() + self._settings.wait_s
        self._fill(seen, WAITING)
        while True:
            found = link.receive(until) if monotonic() < until else None  # a flood of packets ends, too
            if found is None:
                raise WireError(
                    f"no controller came to {written(link.address)} within {self._settings.wait_s:g} s "
                    f"({link.heard}): start `moc-opt control` on the same scenario with the same key, or raise "
                    "[wire] wait_s"
                )
            if found.kind is Kind.START and int(found["session"]) == int(packet["session"]):
                break
            if found.kind is Kind.HELLO:
                link.send(packet, link.sender)
            else:
                link.quality["foreign"] += 1
        link.peer, link.session = link.sender, int(packet["session"])
        if self.clock is not None:
            self.clock.start()

    def pace(self, tick: int) -> None:
        """Wait until a tick begins."""
        if self.clock is not None:
            self._until = self.clock.wait_for(tick)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Send a measurement, and return the torque (n,) [Nm] that came for it, or the watchdog's."""
        watchdog = self._watchdog
        watchdog.see(seen)
        self._control_us, self._reported, self.limited = float("nan"), False, 0
        command = None if watchdog.reason else self._exchange(seen)
        self._missed = command is None and not watchdog.reason
        self.link.quality["missed"] += self._missed
        if command is None:
            tau = watchdog.tick(self._applied)
            if watchdog.reason:
                self.stop_reason = self.stop_reason or watchdog.reason
                self._friction = watchdog.brake_friction()
        else:
            watchdog.missed = 0
            tau = np.array(command["tau"])
            self._friction = np.array(command["friction"])
            self.limited, self._control_us = int(command["limited"]), float(command["control_us"])
            flags = int(command["flags"])
            self._reported = bool(flags & REPORTED)
            if flags & STOP and not self.stop_reason:
                said = bytes(command["reason"][()]).decode(errors="replace")
                self.stop_reason = printable(said) or "the controller asked for it"
        self._applied = tau
        self._tick += 1
        return tau

    def brake_friction(self, seen: Measurement) -> Array:
        """Return the dry friction (n,) [Nm] that came with the last command, or the watchdog's."""
        return self._friction

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the controller's columns, and those of the wire: lateness of the tick, the controller's own time."""
        self._columns = {
            **self._make_columns(ticks), "wake_us": np.full(ticks, np.nan), "control_us": np.full(ticks, np.nan),
            "missed": np.zeros(ticks, dtype=np.bool_),
        }  # fmt: skip
        return dict(self._columns)

    def note(self, row: int, columns: Columns) -> None:
        """Write the last tick's values into a row, and wait for its report where one was announced."""
        columns["missed"][row], columns["control_us"][row] = self._missed, self._control_us
        if self.clock is not None:
            columns["wake_us"][row] = self.clock.late_us
        if self._reported and self._newest[Kind.REPORT] < self._tick - 1:
            self._receive(
                Kind.REPORT, monotonic() + self._settings.resend_s if self.clock is None else self.clock.spare_until
            )

    def close(self) -> dict[str, Any]:
        """Tell the controller, once, that the run is over; return the counts. ``told`` holds its answer."""
        if self._counts:
            return self._counts
        self._packet["flags"] = ENDED
        found, times = None, _BYE_TIMES if self.link.session else 0
        while found is None and times > 0:
            self.link.send(self._packet)
            times -= 1
            found = self._receive(Kind.BYE, monotonic() + _BYE_S)
        if found is not None:
            self.told = _told(bytes(found["words"][()]))
        self.link.close()
        self._counts = self.link.quality | ({} if self.clock is None else {"overruns": self.clock.overruns})
        return self._counts

    def _fill(self, seen: Measurement, state: int) -> None:
        packet = self._packet
        packet["flags"], packet["sequence"], packet["stamp"] = state, self._tick, seen.stamp
        packet["q"], packet["v"], packet["wrench"] = seen.q, seen.v, seen.force
        packet["commanded"], packet["counters"] = self._applied, list(self.link.quality.values())

    def _exchange(self, seen: Measurement) -> Packet | None:
        self._fill(seen, RUNNING)
        for _ in range(1 if self.clock is not None else 1 + self._settings.resends):
            self.link.send(self._packet)
            until = monotonic() + self._settings.resend_s if self.clock is None else self._until
            if (command := self._receive(Kind.COMMAND, until)) is not None:
                return command
        return None

    def _receive(self, wanted: Kind, until: float) -> Packet | None:
        """Return this tick's command, a new report, or the acknowledgement of the end; keep reports on the way."""
        for _ in range(BACKLOG):
            found = self.link.receive(until)
            if found is None:
                break
            new = found.kind not in self._newest or (self._is_usable(found) and self._is_new(found))
            if new and found.kind is Kind.REPORT:
                self._keep(found)
            if new and found.kind is wanted:
                return found
        return None

    def _is_usable(self, packet: Packet) -> bool:
        if packet.kind is Kind.REPORT:
            return True
        friction = packet["friction"]
        inside = (np.abs(packet["tau"]) <= self._tau_max).all() and packet["limited"] <= self.link.n
        usable = bool(inside and ((friction >= 0.0) & (friction < np.inf)).all())
        self.link.quality["foreign"] += not usable
        return usable

    def _is_new(self, packet: Packet) -> bool:
        number = int(packet["sequence"])
        said = self.link.judge(number, self._newest[packet.kind], self._tick)
        if said == "received":
            self._newest[packet.kind] = number
            if packet.kind is Kind.COMMAND and number < self._tick:
                said = "late"
        self.link.quality[said] += 1
        return said == "received"

    def _keep(self, report: Packet) -> None:
        row = int(report["sequence"])
        for name, column in self._columns.items():
            if name in report and row < len(column):
                value = report[name]
                column[row] = printable(bytes(value[()]).decode(errors="replace")) if value.dtype.kind == "S" else value


def _told(words: bytes) -> dict[str, Any]:
    text, names = printable(words.decode(errors="replace")), ("faults", "restarts", "warnings")
    try:
        found = parse_json(text, "last words of the controller", WireError) if text else {}
        told = {name: found[name] for name in names if name in found and (found[name] or name == "faults")}
        for name, value in told.items():
            check_entry(name, value)
    except (MocOptError, TypeError):
        return {}  # of a controller that is not ours; the run is over, and its trace complete without
    return told
