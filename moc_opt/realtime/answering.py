"""The controller's end of the wire: each measurement is answered by the torque of the simulator's own control side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic, perf_counter_ns
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.inputs.files import to_json
from moc_opt.realtime import packets
from moc_opt.realtime.link import Link, WireError, WireSettings, written
from moc_opt.realtime.packets import COUNTERS, ENDED, REPORTED, RUNNING, STOP, WAITING, Kind, Packet
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
    plant: dict[str, int]  #: the plant's own counts, as its last measurement has them
    warnings: list[dict[str, Any]]  #: of the safety filter
    faults: dict[str, Any]  #: of the third level


class Answering:
    """Answers measurements until the plant ends the run.

    Args:
        link: knows the plant's address.
        settings: time-outs.
        make: makes controller and safety filter, as in the simulator's loop; called twice: one pair rehearses a tick.
        tip_refs: (N, 3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2] of every tick.
        registered: (N, 2, 3) place [m] and velocity [m/s] of the registered trocar.
        scenario: fingerprint of the settings that both ends must share.
        ready: called once when the plant has been found.
    """

    def __init__(
        self, link: Link, settings: WireSettings, make: Callable[[], tuple[LoggedController, SafetyFilter]],
        tip_refs: Array, registered: Array, scenario: int, ready: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self._link, self._settings, self._make = link, settings, make
        self._tip_refs, self._registered, self._scenario, self._ready = tip_refs, registered, scenario, ready
        self._newest, self._answered = -1, 0

    def run(self) -> Ending:
        """Find the plant, start at its first measurement, and answer.

        Raises:
            WireError: no plant answers, or it runs another scenario.
        """
        link = self._link
        first = self._ask(Kind.HELLO, lambda m: m["flags"] == WAITING)
        link.session = session = int(first["session"])
        if int(first["scenario"]) != self._scenario:
            raise WireError(
                f"the plant at {written(link.peer)} runs another scenario: give both ends the same robot, start, "
                "trocar, task, seed, period and duration"
            )
        applied = np.array(first["commanded"])
        self._command = Packet(Kind.COMMAND, link.n, session, self._scenario)
        self._report = Packet(Kind.REPORT, link.n, session, self._scenario)
        self._answer(self._started(first), first, applied, rehearsal=True)
        filtered = self._started(first)
        self._ready()
        with no_collector():
            found = self._ask(Kind.START, lambda m: m["flags"] != WAITING)
            ended = self._answer_all(filtered, found, applied)
        if filtered.stop_reason:
            ended = f"stopped: {filtered.stop_reason}"
        plant = dict(zip(COUNTERS, self._counters, strict=True))
        faults = getattr(self._controller, "faults", {})
        return Ending(ended, self._answered, link.quality, plant, filtered.warnings, faults)

    def _started(self, first: Packet) -> FilteredController:
        self._controller, safety_filter = self._make()
        self._blank, self._row = self._controller.columns(1), self._controller.columns(1)
        filtered = FilteredController(self._controller, safety_filter, np.array(first["commanded"]))
        filtered.start(_measurement(first), self._tip_refs[0], self._registered[0])
        return filtered

    def _ask(self, kind: Kind, wanted: Callable[[Packet], Any]) -> Packet:
        link, request = self._link, Packet(kind, self._link.n, self._link.session, self._scenario)
        until = monotonic() + self._settings.wait_s
        while monotonic() < until:
            link.send(request)
            again = min(until, monotonic() + _REPEAT_S)
            found = link.receive(again)
            while found is not None:
                if wanted(found):
                    return found
                found = link.receive(again) if monotonic() < again else None
        raise WireError(
            f"no plant answers at {written(link.peer)} within {self._settings.wait_s:g} s ({link.heard}): start "
            "`moc-opt plant` there, with the same robot and the same key"
        )

    def _answer_all(self, filtered: FilteredController, found: Packet | None, applied: Array) -> str:
        link, quality = self._link, self._link.quality
        while found is not None:
            self._counters = found["counters"].tolist()
            if found["flags"] == ENDED:
                self._say_bye(filtered)
                done, whole = int(found["sequence"]) + 1, len(self._tip_refs)
                return "completed" if done >= whole else f"the plant ended the run at tick {done} of {whole}"
            number, newest, last = int(found["sequence"]), self._newest, len(self._tip_refs) - 1
            said = link.judge(number, newest, last) if found["flags"] == RUNNING else "foreign"
            quality[said] += 1
            if said == "received":
                quality["missed"] += number - newest - 1
                self._newest = number
                applied = self._answer(filtered, found, applied)
            elif said == "doubled":  # the plant has not received the answer
                link.send(self._command)
                link.send(self._report)
            found = link.receive(monotonic() + self._settings.silence_s)
        return f"the plant has been silent for {self._settings.silence_s:g} s"

    def _say_bye(self, filtered: FilteredController) -> None:
        bye, until = Packet(Kind.BYE, self._link.n, self._link.session, self._scenario), monotonic() + _LINGER_S
        bye["words"] = _last_words(self._controller, filtered.warnings)
        self._link.send(bye)
        while monotonic() < until and (again := self._link.receive(until)) is not None:
            if again["flags"] == ENDED:
                self._link.send(bye)

    def _answer(self, filtered: FilteredController, found: Packet, applied: Array, *, rehearsal: bool = False) -> Array:
        begin, number = perf_counter_ns(), int(found["sequence"])
        seen, echo, command, report = _measurement(found), found["commanded"], self._command, self._report
        if not np.array_equal(echo, applied):  # the plant did not hear, and held another torque
            filtered.set_applied_torque(np.array(echo))
        tau = filtered.tick(seen, self._tip_refs[number], self._registered[number])
        command["sequence"], command["tau"], command["limited"] = number, tau, filtered.limited
        command["flags"] = REPORTED
        if filtered.stop_reason:
            command["flags"] = REPORTED | STOP
            command["reason"] = filtered.stop_reason.encode()[: packets.REASON_BYTES]
            command["friction"] = filtered.brake_friction(seen)
        command["control_us"] = (perf_counter_ns() - begin) * 1e-3
        if not rehearsal:
            self._link.send(command)
            self._answered += 1
        for name, column in self._row.items():
            column[:] = self._blank[name]  # a note leaves out what there is not
        self._controller.note(0, self._row)
        for name, column in self._row.items():
            report[name] = column[0]
        report["sequence"] = number
        if not rehearsal:
            self._link.send(report)
        return tau


def _measurement(packet: Packet) -> Measurement:
    return Measurement(np.array(packet["q"]), np.array(packet["v"]), np.array(packet["wrench"]), int(packet["stamp"]))


def _last_words(controller: object, warnings: list[dict[str, Any]]) -> bytes:
    counted = {name: getattr(controller, name) for name in ("faults", "restarts") if hasattr(controller, name)}
    text = to_json(counted | {"warnings": warnings}, indent=None).encode()
    if len(text) > packets.WORDS_BYTES:  # without the texts of refused answers
        faults = {name: {**fault, "first": ""} for name, fault in counted.get("faults", {}).items()}
        text = to_json({"faults": faults, "warnings": warnings}, indent=None).encode()
    return text
