"""The controller's end, with a plant that the test plays: no socket, no clock."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.realtime.answering import Answering
from moc_opt.realtime.link import WireError, WireSettings
from moc_opt.realtime.packets import COUNTERS, ENDED, REPORTED, RUNNING, WAITING, Kind, make_packet

N, TICKS = 3, 4
WAIT = WireSettings(wait_s=0.05, silence_s=0.5)


class Plant:
    """A link whose other end says what the test lists, and hears what is sent."""

    def __init__(self, said):
        self.n, self.peer, self.session, self.quality = N, ("plant", 1), 0, dict.fromkeys(COUNTERS, 0)
        self.said, self.sent, self.heard = list(said), [], "nothing"

    def send(self, packet):
        self.sent.append((Kind(packet["kind"]), packet.copy()))

    def receive(self, until, wanted=lambda packet: True):
        while self.said:
            if wanted(packet := self.said.pop(0)):
                return packet
        return None


def measurement(flags, k=0, commanded=0.0, scenario=9):
    packet = make_packet(Kind.MEASUREMENT, N, 5, scenario)
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


@pytest.mark.parametrize(("ticks", "commands", "corrected", "counts", "ended"), [
    ([(0, 0), (1, 1), (2, 2), (3, 3)], [(0, 1), (1, 2), (2, 3), (3, 4)], [], (4, 0, 0), "completed"),
    # The plant did not hear the second command, and held the first torque.
    ([(0, 0), (1, 1), (2, 1), (3, 3)], [(0, 1), (1, 2), (2, 3), (3, 4)], [(2, 1)], (4, 0, 0), "completed"),
    # A measurement that is repeated is answered by the same command once more.
    ([(0, 0), (1, 1), (1, 1)], [(0, 1), (1, 2), (1, 2)], [], (2, 0, 1), "the plant ended the run at tick 2 of 4"),
    # Measurements that never came are counted.
    ([(0, 0), (3, 1), (1, 1)], [(0, 1), (3, 2)], [], (2, 2, 1), "completed"),
])  # fmt: skip
def test_every_tick_is_answered_and_the_end_acknowledged(ticks, commands, corrected, counts, ended):
    """``ticks`` has the number of each measurement, and the torque that acted before it."""
    last = measurement(ENDED, max(ticks)[0])
    ending, plant, controller = answered(
        [measurement(WAITING), *(measurement(RUNNING, k, tau) for k, tau in ticks), last]
    )
    sent = [said for kind, said in plant.sent if kind is Kind.COMMAND]
    assert [(int(said["sequence"]), said["tau"].tolist()) for said in sent] == [(k, [tau] * N) for k, tau in commands]
    assert controller.corrected == [(k, [tau] * N) for k, tau in corrected]
    assert tuple(ending.quality[name] for name in ("received", "missed", "late")) == counts
    assert (ending.ended, ending.ticks) == (ended, counts[0])
    assert plant.sent[-1][0] is Kind.BYE
    assert {int(said["flags"]) for said in sent} == {REPORTED}


@pytest.mark.parametrize("said", [[measurement(WAITING, scenario=8)], [], [measurement(RUNNING)] * 100])
def test_a_plant_of_another_scenario_or_none_is_refused(said):
    with pytest.raises(WireError):
        answered(said)


def test_a_measurement_from_no_possible_period_is_not_answered():
    odd = measurement(RUNNING, 1)
    odd["stamp"] = -(2**63)
    ending, _, _ = answered([measurement(WAITING), measurement(RUNNING), odd, measurement(ENDED, 1)])
    assert (ending.quality["foreign"], ending.quality["received"]) == (1, 1)
