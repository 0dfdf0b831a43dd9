"""The controller's end, with a plant that the test plays: no socket, no clock."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.realtime.answering import Answering
from moc_opt.realtime.link import WireError, WireSettings
from moc_opt.realtime.packets import COUNTERS, ENDED, REPORTED, RUNNING, WAITING, Kind, Packet

N, TICKS = 3, 4
WAIT = WireSettings(wait_s=0.05, silence_s=0.5)


class Plant:
    """A link whose other end says what the test lists, and hears what is sent."""

    def __init__(self, said):
        self.n, self.peer, self.session, self.quality = N, ("plant", 1), 0, dict.fromkeys(COUNTERS, 0)
        self.said, self.sent, self.heard = list(said), [], "nothing"

    def send(self, packet):
        self.sent.append((packet.kind, {name: np.array(packet[name]) for name in ("sequence", "flags")}))
        if packet.kind is Kind.COMMAND:
            self.sent[-1][1]["tau"] = np.array(packet["tau"])

    def receive(self, until):
        return self.said.pop(0) if self.said else None


def measurement(flags, k=0, commanded=0.0, scenario=9):
    packet = Packet(Kind.MEASUREMENT, N, 5, scenario)
    packet["flags"], packet["sequence"], packet["stamp"] = flags, k, k
    packet["commanded"] = commanded
    return packet


class Controller:
    """Asks for the torque k in the k-th tick after its start; remembers what it was told of the torque that acted."""

    def __init__(self):
        self.corrected, self.k, self.faults = [], 0, {}

    def start(self, q, v, tip_ref, trocar):
        self.k, self.corrected = 0, []

    def tick(self, q, v, tip_ref, trocar):
        self.k += 1
        return np.full(N, float(self.k))

    def set_applied_torque(self, tau):
        self.corrected.append((self.k, tau.tolist()))

    def columns(self, ticks):
        return {"solve_us": np.full(ticks, np.nan)}

    def note(self, row, columns):
        columns["solve_us"][row] = self.k


def answered(said):
    plant, controller = Plant(said), Controller()
    end = Answering(plant, WAIT, controller, None, np.zeros((TICKS, 3, 3)), np.zeros((TICKS, 2, 3)), scenario=9)
    return end.run(), plant, controller


def commands(plant):
    return [(int(said["sequence"]), said["tau"].tolist()) for kind, said in plant.sent if kind is Kind.COMMAND]


def running(torques):
    """Measurements of the ticks 0, 1, ...: the torque that acted before each."""
    return [measurement(RUNNING, k, tau) for k, tau in enumerate(torques)]


def test_every_tick_is_answered_and_the_end_acknowledged():
    ending, plant, controller = answered(
        [measurement(WAITING), *running([0.0, 1.0, 2.0, 3.0]), measurement(ENDED, TICKS - 1)]
    )
    assert commands(plant) == [(k, [k + 1.0] * N) for k in range(TICKS)]
    assert (ending.ended, ending.ticks, ending.quality["received"]) == ("completed", TICKS, TICKS)
    assert controller.corrected == []
    assert plant.sent[-1][0] is Kind.BYE
    assert {int(said["flags"]) for kind, said in plant.sent if kind is Kind.COMMAND} == {REPORTED}


def test_the_controller_is_told_of_a_torque_that_acted_in_place_of_its_own():
    """The plant did not hear the second command, and held the first torque."""
    _, _, controller = answered([measurement(WAITING), *running([0.0, 1.0, 1.0, 3.0]), measurement(ENDED, TICKS - 1)])
    assert controller.corrected == [(2, [1.0] * N)]


def test_a_measurement_that_is_repeated_is_answered_by_the_same_command_once_more():
    twice = running([0.0, 1.0])
    ending, plant, _ = answered([measurement(WAITING), twice[0], twice[1], twice[1], measurement(ENDED, 1)])
    assert commands(plant) == [(0, [1.0] * N), (1, [2.0] * N), (1, [2.0] * N)]
    assert (ending.ticks, ending.quality["late"]) == (2, 1)


def test_measurements_that_never_came_are_counted():
    all_of = running([0.0, 1.0, 2.0, 3.0])
    ending, _, _ = answered([measurement(WAITING), all_of[0], all_of[3], all_of[1], measurement(ENDED, TICKS - 1)])
    assert (ending.ticks, ending.quality["missed"], ending.quality["late"]) == (2, 2, 1)


def test_an_end_before_the_last_tick_is_not_called_complete():
    ending, _, _ = answered([measurement(WAITING), *running([0.0, 1.0]), measurement(ENDED, 1)])
    assert ending.ended == "the plant ended the run at tick 2 of 4"


@pytest.mark.parametrize("said", [[measurement(WAITING, scenario=8)], [], [measurement(RUNNING)] * 100])
def test_a_plant_of_another_scenario_or_none_is_refused(said):
    with pytest.raises(WireError):
        answered(said)
