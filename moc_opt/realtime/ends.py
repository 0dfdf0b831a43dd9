"""Ends of the wire (UDP packets): `RemoteController` in the plant's process, `Answering` in the controller's.

docs/realtime.md describes the sequence of their packets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from secrets import randbits
from time import monotonic, perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.control.safety_filter import MOST_TICKS, SafetyFilter
from moc_opt.errors import printable
from moc_opt.realtime import wire
from moc_opt.realtime.clock import WallClock
from moc_opt.realtime.wire import Kind, Link, Packet, WireError, WireSettings, make_packet, written
from moc_opt.sim.loop import FilteredController, no_collector
from moc_opt.sim.protocols import Filtered, LoggedController
from moc_opt.sim.sensors import Measurement

INCOMING = (Kind.HELLO, Kind.START, Kind.COMMAND, Kind.BYE)
SAME = "give both ends the same file, or the same robot, start, trocar, task, seed, period and duration"
_ENDED_S, _ENDED_TIMES = 0.1, 10  # interval [s] and largest number of packets with ENDED
_REPEAT_S = 0.1  # interval of HELLO and START [s]
_LINGER_S = 0.3  # time for which repeated ENDED packets are answered [s]


class RemoteController(Filtered):
    """The plant's end of the wire. It sends measurements, and returns the torques of the commands.

    Without commands, a watchdog holds the last torque, then damps the arm, and at last stops it. Pass the
    object to `sim.loop.simulate`, with ``pace`` as ``watch``. Call ``close`` afterwards.

    Args:
        safety_filter: only computes the torques and brakes of the watchdog.
        columns: makes the controller's trace columns for a number of ticks.
        applied: (n,) torque before the first tick [Nm]. tau_max: (n,) largest torques of a command [Nm].
        clock: begins the ticks in real time. None: lock-step, in which the plant waits for each command.
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

    limited = property(lambda self: 0 if self._command is None else int(self._command["limited"]))
    warnings = property(lambda self: [])  # the controller's end records them

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Answer each HELLO with the first measurement, until a START comes. Raise a WireError if none comes."""
        link, packet, self._sound, others = self.link, self._packet, seen, set[str]()
        self._fill(seen, wire.WAITING)

        def starts(found: Packet) -> bool:
            if found["kind"] == Kind.HELLO:
                if found["scenario"] not in (0, packet["scenario"]):  # 0: not told
                    others.add(written(link.sender))
                link.send(packet, link.sender)
                return False
            begins = found["kind"] == Kind.START and found["session"] == packet["session"]
            link.quality["foreign"] += not begins
            return bool(begins)

        if link.receive(monotonic() + self._settings.wait_s, starts) is None:
            if others:
                raise WireError(f"the controller at {', '.join(others)} runs another scenario: {SAME}")
            raise WireError(
                f"no controller contacted {written(link.address)} within {self._settings.wait_s:g} s ({link.heard}): "
                "start `moc-opt control` on the same scenario with the same key, or raise [wire] wait_s"
            )
        link.peer, link.session = link.sender, int(packet["session"])

    def pace(self, tick: int) -> None:
        """In real time, wait until a tick begins."""
        if self.clock is not None:
            self._until = self.clock.wait_for(tick)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Send a measurement, and return the torque (n,) [Nm] of the command or of the watchdog."""
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
            if int(command["flags"]) & wire.STOP and not self.stop_reason:
                self.stop_reason = _text(command["reason"]) or "the controller requested a stop"
        self._tick += 1
        return self._applied

    def _without_command(self) -> Array:
        self._silent += 1
        safety, past, sound = self._filter, self._silent - self._settings.hold_ticks, self._sound
        if past <= 0:
            return self._applied
        if not safety.reason:
            safety.start(sound.q, sound.v, sound.stamp)  # sets the pose whose gravity torque is used
            if past <= self._settings.damp_ticks:
                return safety.stop_torque(self._applied) - self._settings.damping_Nm_s_per_rad * sound.v
            safety.request_stop(f"no command from the controller for {self._silent} ticks")
            self.stop_reason = self.stop_reason or safety.reason
        self._friction = safety.brake_friction(sound.force)
        return safety.stop_torque(self._applied)

    def brake_friction(self, seen: Measurement) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes."""
        return self._friction

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the trace's columns."""
        return {
            **self._make_columns(ticks), "wake_us": np.full(ticks, np.nan), "control_us": np.full(ticks, np.nan),
            "missed": np.zeros(ticks, dtype=np.bool_),
        }  # fmt: skip

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the latest tick's values into a row."""
        command, columns["missed"][row] = self._command, self._missed
        if self.clock is not None:
            columns["wake_us"][row] = self.clock.late_us
        if command is not None:
            reported = int(command["flags"]) & wire.REPORTED
            for name in columns.keys() & set(command.dtype.names or ()) if reported else ("control_us",):
                value = command[name]
                columns[name][row] = _text(value) if value.dtype.kind == "S" else value

    def close(self) -> dict[str, int]:
        """Tell the controller that the run is over. Return the packet counts."""

        def acknowledges(found: Packet) -> bool:
            self._is_due(found)  # only to count a command that came too late
            return bool(found["kind"] == Kind.BYE)

        self._packet["flags"], link = wire.ENDED, self.link
        for _ in range(_ENDED_TIMES if link.session else 0):
            link.send(self._packet)
            if link.receive(monotonic() + _ENDED_S, acknowledges) is not None:
                break
        link.session = 0
        link.close()
        return link.quality | ({} if self.clock is None else {"overruns": self.clock.overruns})

    def _fill(self, seen: Measurement, state: int) -> None:
        packet = self._packet
        packet["flags"], packet["sequence"], packet["stamp"] = state, self._tick, seen.stamp
        packet["q"], packet["v"], packet["wrench"], packet["commanded"] = seen.q, seen.v, seen.force, self._applied

    def _exchange(self, seen: Measurement) -> Packet | None:
        self._fill(seen, wire.RUNNING)
        # In lock-step, an unanswered measurement is sent again, unless the tick before was missed.
        for _ in range(1 if self.clock is not None or self._silent else 1 + self._settings.resends):
            self.link.send(self._packet)
            until = monotonic() + self._settings.resend_s if self.clock is None else self._until
            if (command := self.link.receive(until, self._is_due)) is not None:
                return command
        return None

    def _is_due(self, found: Packet) -> bool:
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


@dataclass(eq=False)
class Answering:
    """The controller's end of the wire."""

    link: Link
    settings: WireSettings
    controller: LoggedController
    safety_filter: SafetyFilter | None  #: None: measurements and torques are not checked.
    tip_refs: Array  #: (N, 3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
    registered: Array  #: (N, 2, 3) position [m] and velocity [m/s] of the registered trocar.
    scenario: int  #: Fingerprint (hash) of the scenario, equal at both ends.
    ready: Callable[[], None] = lambda: None  #: Called before START is sent.

    def run(self) -> dict[str, Any]:
        """Answer until the run ends.

        Return ``ended`` (how the run ended), ``ticks`` (number of answered ticks), ``quality`` (packet counts),
        ``warnings`` of the safety filter and ``faults`` of the solver.

        Raises:
            WireError: no plant answers, or the plant runs another scenario.
        """
        link = self.link
        first = self._ask(Kind.HELLO, waits=True)
        link.session = int(first["session"])
        if int(first["scenario"]) != self.scenario:
            raise WireError(f"the plant at {written(link.peer)} runs another scenario: {SAME}")
        self._command = self._packet(Kind.COMMAND)
        self._command["tau"] = first["commanded"]
        filtered = FilteredController(self.controller, self.safety_filter, np.array(first["commanded"]))
        filtered.start(_measurement(first), self.tip_refs[0], self.registered[0])
        self.ready()
        with no_collector():
            ended = self._answer_all(self._ask(Kind.START, waits=False), filtered)
        if filtered.stop_reason:
            ended = f"stopped: {filtered.stop_reason}"
        return {
            "ended": ended, "ticks": link.quality["received"], "quality": link.quality, "warnings": filtered.warnings,
            "faults": getattr(self.controller, "faults", {}),
        }  # fmt: skip

    def _packet(self, kind: Kind) -> Packet:
        return make_packet(kind, self.link.n, self.link.session, self.scenario)

    def _ask(self, kind: Kind, *, waits: bool) -> Packet:
        """Repeat a packet until a measurement arrives. ``waits`` tells whether its flag must be WAITING or must not."""
        link, request, until = self.link, self._packet(kind), monotonic() + self.settings.wait_s
        while (now := monotonic()) < until:
            link.send(request)
            found = link.receive(min(until, now + _REPEAT_S), lambda packet: (packet["flags"] == wire.WAITING) == waits)
            if found is not None:
                return found
        raise WireError(
            f"no plant answers at {written(link.peer)} within {self.settings.wait_s:g} s ({link.heard}): start "
            "`moc-opt plant` there, with the same robot and the same key"
        )

    def _answer_all(self, found: Packet | None, filtered: FilteredController) -> str:
        link, quality, newest, whole = self.link, self.link.quality, -1, len(self.tip_refs)
        while found is not None:
            number, flags = int(found["sequence"]), int(found["flags"])
            if flags == wire.ENDED:
                self._say_bye()
                done = number + 1
                return "completed" if done >= whole else f"the plant ended the run at tick {done} of {whole}"
            if flags != wire.RUNNING or number >= whole or not 0 <= found["stamp"] <= MOST_TICKS:
                quality["foreign"] += 1
            elif number > newest:
                quality["received"] += 1
                quality["missed"] += number - newest - 1
                newest = number
                self._answer(found, filtered)
            else:
                quality["late"] += 1
                if number == newest:  # the command was probably lost, so the plant asks again
                    link.send(self._command)
            found = link.receive(monotonic() + self.settings.silence_s)
        return f"the plant has been silent for {self.settings.silence_s:g} s"

    def _answer(self, found: Packet, filtered: FilteredController) -> None:
        begin, number, command, seen = perf_counter_ns(), int(found["sequence"]), self._command, _measurement(found)
        if not np.array_equal(found["commanded"], command["tau"]):  # the watchdog's torque acted in the tick before
            filtered.set_applied_torque(np.array(found["commanded"]))
        command["tau"] = filtered.tick(seen, self.tip_refs[number], self.registered[number])
        command["sequence"], command["limited"], command["flags"] = number, filtered.limited, wire.REPORTED
        if filtered.stop_reason:
            command["flags"] = wire.REPORTED | wire.STOP
            command["reason"] = filtered.stop_reason.encode()
            command["friction"] = filtered.brake_friction(seen)
        command["control_us"] = (perf_counter_ns() - begin) * 1e-3
        report = self.controller.columns(1)
        self.controller.note(0, report)
        for name, column in report.items():
            command[name] = column[0]
        self.link.send(command)

    def _say_bye(self) -> None:
        bye, until = self._packet(Kind.BYE), monotonic() + _LINGER_S
        self.link.send(bye)
        while monotonic() < until and (again := self.link.receive(until)) is not None:
            if again["flags"] == wire.ENDED:
                self.link.send(bye)


def _measurement(packet: Packet) -> Measurement:
    return Measurement(np.array(packet["q"]), np.array(packet["v"]), np.array(packet["wrench"]), int(packet["stamp"]))
