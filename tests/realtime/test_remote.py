"""The plant's end, with packets that are there before it looks: no thread and no clock."""

from __future__ import annotations

import socket
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.realtime.link import Link, WireError, WireSettings
from moc_opt.realtime.packets import REPORTED, RUNNING, STOP, Kind, Packet, layout, make_packet, seal
from moc_opt.realtime.remote import INCOMING, RemoteController
from moc_opt.scenario import Scenario, make_safety_filter
from moc_opt.sim.sensors import Measurement

KEY = b"k" * 16
SETTINGS = WireSettings(hold_ticks=2, damp_ticks=3, wait_s=0.1)
NOTHING = np.zeros((3, 3)), np.zeros((2, 3))
NO_TIME: Any = SimpleNamespace(late_us=0.0, overruns=0, wait_for=lambda tick: 0.0)
"""A clock whose ticks are over as soon as they begin: only what has arrived already counts."""


class Peer:
    """The controller, played by the test."""

    def __init__(self, robot) -> None:
        self.n, self.k = robot.n, 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link = Link(self.n, KEY, INCOMING, listen=("127.0.0.1", 0))
        guard = make_safety_filter(robot, Scenario(guard=SafetyFilterSettings().model_dump()))
        self.hold = robot.gravity(robot.data.q_home)
        self.plant = RemoteController(
            self.link, SETTINGS, guard, lambda ticks: {"solve_us": np.full(ticks, np.nan)}, self.hold, robot.tau_max, 9,
            NO_TIME,
        )  # fmt: skip
        self.columns = self.plant.columns(50)
        self.session = int(self.plant._packet["session"])
        self.seen = Measurement(np.array(robot.data.q_home), np.zeros(self.n), np.zeros(6))

    def say(self, kind: Kind, number: int = 0, **values) -> None:
        packet = make_packet(kind, self.n, 0 if kind is Kind.HELLO else self.session, 9)
        for name, value in ({"sequence": number} | values).items():
            packet[name] = value
        self.socket.sendto(seal(packet, KEY), self.link.address)

    def start(self) -> None:
        self.say(Kind.HELLO)
        self.say(Kind.START)
        self.plant.start(self.seen, *NOTHING)

    def tick(self, v=0.0):
        self.plant.pace(self.k)
        tau = self.plant.tick(self.seen._replace(v=np.full(self.n, v), stamp=self.k), *NOTHING)
        self.plant.note(self.k, self.columns)
        self.k += 1
        return tau

    def heard(self) -> Packet:
        return np.frombuffer(self.socket.recv(4096), layout(Kind.MEASUREMENT, self.n)).reshape(())


@pytest.fixture
def peer(robot):
    made = Peer(robot)
    yield made
    made.socket.close()
    made.link.close()


def test_start_of_another_session_begins_nothing(peer):
    peer.say(Kind.HELLO)
    peer.say(Kind.START, session=peer.session ^ 1)
    peer.say(Kind.COMMAND)
    with pytest.raises(WireError, match="no controller came"):
        peer.plant.start(peer.seen, *NOTHING)
    assert peer.link.quality["foreign"] == 2


def test_commands_are_followed_and_every_fault_has_its_count(peer):
    peer.start()
    ones, quality = np.ones(peer.n), peer.link.quality
    peer.say(Kind.COMMAND, 0, tau=ones, limited=3, control_us=12.0, flags=REPORTED, solve_us=2.0)
    np.testing.assert_array_equal(peer.tick(), ones)
    assert peer.plant.limited == 3
    assert (peer.columns["control_us"][0], peer.columns["solve_us"][0]) == (12.0, 2.0)
    assert (quality["received"], quality["missed"]) == (1, 0)
    np.testing.assert_array_equal(peer.tick(), ones)  # no command for tick 1: held
    assert (quality["missed"], peer.plant.limited) == (1, 0)
    assert peer.columns["missed"][:2].tolist() == [False, True]
    peer.say(Kind.COMMAND, 1, tau=7 * ones)  # late: not followed
    peer.say(Kind.COMMAND, 4, tau=7 * ones)  # of a tick to come
    peer.say(Kind.COMMAND, 2, tau=np.nan * ones)
    np.testing.assert_array_equal(peer.tick(), ones)
    assert (quality["late"], quality["foreign"], quality["missed"]) == (1, 2, 2)
    peer.say(Kind.COMMAND, 3, tau=2 * ones, control_us=8.0, solve_us=5.0)  # and no report
    peer.say(Kind.COMMAND, 3, tau=3 * ones)  # again, and otherwise
    np.testing.assert_array_equal(peer.tick(), 2 * ones)
    assert (peer.columns["control_us"][3], np.isnan(peer.columns["solve_us"][3])) == (8.0, True)
    np.testing.assert_array_equal(peer.tick(), 2 * ones)
    assert (quality["received"], quality["missed"], quality["late"]) == (2, 3, 2)
    for _ in range(6):
        shown = peer.heard()
    assert (shown["flags"], shown["sequence"]) == (RUNNING, 4)
    np.testing.assert_array_equal(shown["commanded"], 2 * ones)


@pytest.mark.parametrize("wrong", [
    {"tau": 1e300}, {"tau": -500.0}, {"tau": np.nan}, {"friction": -1.0}, {"limited": 8},
    {"flags": STOP, "friction": np.inf},
])  # fmt: skip
def test_a_command_that_no_safety_filter_gives_is_not_followed(peer, wrong):
    peer.start()
    held = peer.tick()
    peer.say(Kind.COMMAND, 1, **({"tau": 1.0} | wrong))
    np.testing.assert_array_equal(peer.tick(), held)
    assert (peer.link.quality["foreign"], peer.link.quality["missed"]) == (1, 2)
    assert not peer.plant.stop_reason


def test_the_watchdog_holds_then_damps_then_brakes(peer):
    peer.start()
    ones = np.ones(peer.n)
    peer.say(Kind.COMMAND, 0, tau=ones)
    peer.tick()
    for _ in range(SETTINGS.hold_ticks):
        np.testing.assert_array_equal(peer.tick(v=0.1), ones)
    for k in range(SETTINGS.damp_ticks):
        tau = peer.tick(v=0.1)
        assert peer.plant.stop_reason == ""
        step = 0.002 * SafetyFilterSettings().torque_rate_Nm_per_s
        if (np.abs(peer.hold - 1.0) < step).all() and k == 0:
            np.testing.assert_allclose(tau, peer.hold - 0.5, atol=1e-9)  # weight less 5 Nm s/rad times 0.1 rad/s
    np.testing.assert_allclose(tau, peer.hold - 0.5, atol=1e-9)
    peer.say(Kind.COMMAND, peer.k, tau=3 * ones)
    np.testing.assert_array_equal(peer.tick(), 3 * ones)  # a command in time: followed again
    for _ in range(SETTINGS.hold_ticks + SETTINGS.damp_ticks + 1):
        tau = peer.tick()
    assert peer.plant.stop_reason == "no command from the controller for 6 ticks"
    assert (peer.plant.brake_friction(peer.seen) > 0.0).all()
    peer.say(Kind.COMMAND, peer.k, tau=3 * ones)
    np.testing.assert_allclose(peer.tick(), peer.hold, atol=1e-9)  # brakes stay closed
    assert peer.plant.stop_reason == "no command from the controller for 6 ticks"


def test_what_the_controller_stops_stays_stopped(peer):
    peer.start()
    ones = np.ones(peer.n)
    peer.say(Kind.COMMAND, 0, tau=ones, flags=STOP, reason=b"because\x1b", friction=2 * ones)
    peer.tick()
    peer.say(Kind.COMMAND, 1, tau=ones, friction=3 * ones)
    peer.tick()
    assert peer.plant.stop_reason == "because\ufffd"
    np.testing.assert_array_equal(peer.plant.brake_friction(peer.seen), 3 * ones)


LATE = {"late": {"count": 2, "first_at_s": 1.5, "first": "so"}}


@pytest.mark.parametrize(("words", "told"), [
    (b'{"faults": {}, "warnings": [], "other": 1}', {"faults": {}}),
    (b'{"faults": {"late": {"count": 2, "first_at_s": 1.5, "first": "so"}}, "restarts": []}', {"faults": LATE}),
    (b'{"faults": {"late": {"count": "2", "first_at_s": 1.5, "first": "so"}}}', {}),
    (b"", {}), (b"[1]", {}), (b"3", {}), (b"\xff\xfe", {}),
])  # fmt: skip
def test_the_last_words_go_into_the_meta_or_nowhere(peer, words, told):
    peer.start()
    peer.say(Kind.BYE, words=words)
    assert peer.plant.close() == told | {"wire": peer.link.quality | {"overruns": 0}}
