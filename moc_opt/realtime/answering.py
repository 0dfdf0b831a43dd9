"""The controller's end of the wire: each measurement is answered by the torque of the simulator's own control side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic, perf_counter_ns
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.control.safety_filter import MOST_TICKS, SafetyFilter
from moc_opt.inputs.files import to_json
from moc_opt.realtime.link import Link, WireError, WireSettings, written
from moc_opt.realtime.packets import ENDED, REPORTED, RUNNING, STOP, WAITING, Kind, Packet, make_packet
from moc_opt.sim.loop import FilteredController, no_collector
from moc_opt.sim.protocols import LoggedController
from moc_opt.sim.sensors import Measurement

_REPEAT_S = 0.1  # after which HELLO and START are sent again
_LINGER_S = 0.3  # for which the end is acknowledged again


@dataclass(frozen=True)
class Ending:
    """How a run looked from the controller's end."""

    ended: str  #: "completed", "stopped: ...", "the plant ended the run at tick ...", "the plant has been silent ...".
    ticks: int  #: measurements that were answered
    quality: dict[str, int]  #: counts of the plant's packets
    warnings: list[dict[str, Any]]  #: of the safety filter
    faults: dict[str, Any]  #: of the third level


@dataclass(eq=False)
class Answering:
    """Answers measurements until the plant ends the run."""

    link: Link
    settings: WireSettings
    controller: LoggedController
    safety_filter: SafetyFilter | None
    tip_refs: Array  #: (N, 3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2] of every tick.
    registered: Array  #: (N, 2, 3) place [m] and velocity [m/s] of the registered trocar.
    scenario: int  #: Fingerprint of the settings that both ends must share.
    ready: Callable[[], None] = lambda: None  #: Called once when plant and controller are there.

    def run(self) -> Ending:
        """Find the plant, start at its first measurement, and answer.

        Raises:
            WireError: no plant answers, or it runs another scenario.
        """
        link = self.link
        first = self._ask(Kind.HELLO, lambda flags: flags == WAITING)
        link.session = int(first["session"])
        if int(first["scenario"]) != self.scenario:
            raise WireError(
                f"the plant at {written(link.peer)} runs another scenario: give both ends the same robot, start, "
                "trocar, task, seed, period and duration"
            )
        self._command = self._packet(Kind.COMMAND)
        self._command["tau"] = first["commanded"]
        self._filtered = FilteredController(self.controller, self.safety_filter, np.array(first["commanded"]))
        self._filtered.start(_measurement(first), self.tip_refs[0], self.registered[0])
        self.ready()
        with no_collector():
            ended = self._answer_all(self._ask(Kind.START, lambda flags: flags != WAITING))
        if self._filtered.stop_reason:
            ended = f"stopped: {self._filtered.stop_reason}"
        faults = getattr(self.controller, "faults", {})
        return Ending(ended, link.quality["received"], link.quality, self._filtered.warnings, faults)

    def _packet(self, kind: Kind) -> Packet:
        return make_packet(kind, self.link.n, self.link.session, self.scenario)

    def _ask(self, kind: Kind, wanted: Callable[[int], bool]) -> Packet:
        """Send a packet over and over until a measurement comes that has such flags."""
        link, request, until = self.link, self._packet(kind), monotonic() + self.settings.wait_s
        while monotonic() < until:
            link.send(request)
            found = link.receive(min(until, monotonic() + _REPEAT_S), lambda packet: wanted(int(packet["flags"])))
            if found is not None:
                return found
        raise WireError(
            f"no plant answers at {written(link.peer)} within {self.settings.wait_s:g} s ({link.heard}): start "
            "`moc-opt plant` there, with the same robot and the same key"
        )

    def _answer_all(self, found: Packet | None) -> str:
        link, quality, newest, whole = self.link, self.link.quality, -1, len(self.tip_refs)
        while found is not None:
            number, flags = int(found["sequence"]), int(found["flags"])
            if flags == ENDED:
                self._say_bye()
                done = number + 1
                return "completed" if done >= whole else f"the plant ended the run at tick {done} of {whole}"
            if flags != RUNNING or number >= whole or not 0 <= found["stamp"] <= MOST_TICKS:
                quality["foreign"] += 1
            elif number > newest:
                quality["received"] += 1
                quality["missed"] += number - newest - 1
                newest = number
                self._answer(found)
            else:
                quality["late"] += 1
                if number == newest:  # the plant has not received the answer
                    link.send(self._command)
            found = link.receive(monotonic() + self.settings.silence_s)
        return f"the plant has been silent for {self.settings.silence_s:g} s"

    def _answer(self, found: Packet) -> None:
        begin, number, command, filtered = perf_counter_ns(), int(found["sequence"]), self._command, self._filtered
        seen = _measurement(found)
        if not np.array_equal(found["commanded"], command["tau"]):  # the plant did not hear, and held another torque
            filtered.set_applied_torque(np.array(found["commanded"]))
        command["tau"] = filtered.tick(seen, self.tip_refs[number], self.registered[number])
        command["sequence"], command["limited"], command["flags"] = number, filtered.limited, REPORTED
        if filtered.stop_reason:
            command["flags"] = REPORTED | STOP
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
        words = {
            name: getattr(self.controller, name) for name in ("faults", "restarts") if hasattr(self.controller, name)
        }
        bye["words"] = to_json(words | {"warnings": self._filtered.warnings}, indent=None).encode()
        self.link.send(bye)
        while monotonic() < until and (again := self.link.receive(until)) is not None:
            if again["flags"] == ENDED:
                self.link.send(bye)


def _measurement(packet: Packet) -> Measurement:
    return Measurement(np.array(packet["q"]), np.array(packet["v"]), np.array(packet["wrench"]), int(packet["stamp"]))
