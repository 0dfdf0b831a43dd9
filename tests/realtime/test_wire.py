"""Packets, and both ends of the link."""

import os
import re
import socket
from contextlib import closing
from itertools import count
from pathlib import Path
from time import monotonic
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.realtime import clock, wire
from moc_opt.realtime.ends import Answering
from moc_opt.realtime.wire import Kind, Link, WireError, WireSettings, layout, make_packet, seal, sealed
from tests.realtime.relay import NOTHING, SCENARIO, SETTINGS, Peer

PAGE = (Path(__file__).parents[2] / "docs" / "realtime.md").read_text(encoding="utf-8")
KINDS = (Kind.MEASUREMENT, Kind.COMMAND)
KEY = b"sixteen bytes or more"


def table(mark: str) -> list[tuple[int, str, str]]:
    """Return (offset, field, type) for each row of a table in docs/realtime.md."""
    text = PAGE.partition(f"<!-- {mark} -->\n")[2].partition("\n\n")[0]
    return [(int(a), b, c) for a, b, c in re.findall(r"^\| (\d+) \| (\w+) \| ([^|]+) \|", text, re.MULTILINE)]


@pytest.mark.parametrize("kind", KINDS)
def test_page_lists_every_field(kind):
    dtype, times = layout(kind, 7), {(): "", (7,): " x n", (6,): " x 6", (87,): " x (11 n + 10)"}
    fields = [(at, name, of.base.str.lstrip("<|") + times[of.shape]) for name, (of, at) in dtype.fields.items()]
    assert table("header") + table(kind.name) == fields[:-1]
    assert f"{kind.name} ({dtype.itemsize} bytes)" in PAGE
    assert f"{int(kind)} {kind.name}" in PAGE


@given(st.sampled_from(KINDS), st.data())
def test_one_changed_bit_or_another_key_fails_the_authentication(kind, data):
    packet = make_packet(kind, 7, session=5, scenario=9)
    sent = seal(packet, KEY)
    assert sealed(sent, KEY)
    bit = data.draw(st.integers(0, 8 * len(sent) - 1))
    changed = bytearray(sent)
    changed[bit // 8] ^= 1 << bit % 8
    assert not sealed(changed, KEY)
    assert not sealed(sent, KEY[:-1] + b"x")


@pytest.fixture
def ends():
    plant = Link(7, KEY, (Kind.COMMAND, Kind.HELLO), listen=("127.0.0.1", 0))
    with closing(plant), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.bind(("127.0.0.1", 0))
        yield plant, controller


def command(kind=Kind.COMMAND, n=7, session=4, **changes):
    packet = make_packet(kind, n, session)
    for name, value in changes.items():
        packet[name] = value
    return packet


def test_only_valid_packets_pass(ends):
    plant, controller = ends
    plant.session, plant.peer = 4, controller.getsockname()
    foreign = (
        seal(command(sequence=3), KEY)[:-1], seal(command(sequence=3), KEY) + b"\0", b"", seal(command(n=6), KEY),
        seal(command(session=5), KEY), seal(command(magic=b"OTHR"), KEY), seal(command(version=9), KEY),
        seal(command(joints=6), KEY), seal(command(kind=Kind.MEASUREMENT), KEY),  # only the plant sends measurements
    )  # fmt: skip
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(seal(command(sequence=1), KEY), plant.address)  # not the address that began the session
        for data in (seal(command(sequence=2), b"l" * 16), *foreign, seal(command(sequence=8), KEY)):
            controller.sendto(data, plant.address)
        found = plant.receive(monotonic() + 5.0)
    assert found["sequence"] == 8
    assert plant.sender == controller.getsockname()
    assert plant.receive(monotonic()) is None
    assert plant.quality == {"received": 0, "missed": 0, "late": 0, "forged": 1, "foreign": 1 + len(foreign)}


def test_flood_of_packets_is_not_read_completely(ends):
    plant, controller = ends
    controller.sendto(seal(command(sequence=1), KEY), plant.address)
    assert plant.receive(monotonic() - 1.0) is not None
    for flood in (b"x", seal(command(sequence=2), KEY)):  # invalid packets, then packets of another tick
        for _ in range(wire.BACKLOG):  # the system may drop packets of the second flood
            controller.sendto(flood, plant.address)
        controller.sendto(seal(command(sequence=3), KEY), plant.address)
        assert plant.receive(monotonic() - 1.0, lambda packet: packet["sequence"] == 3) is None
        while plant.receive(monotonic()) is not None:
            pass
    assert plant.quality["foreign"] == wire.BACKLOG


def test_wrong_address_is_refused():
    assert wire.parse_address("127.0.0.1:30200", "--listen") == ("127.0.0.1", 30200)
    assert wire.parse_address("localhost:0", "--listen") == ("127.0.0.1", 0)
    for wrong in ("30200", "127.0.0.1", ":30200", "1.1.1.1:x", "1.1.1.1:70000", "no host.invalid:1"):
        with pytest.raises(WireError):
            wire.parse_address(wrong, "--listen")


def test_key_is_required_beyond_loopback(tmp_path, monkeypatch):
    monkeypatch.delenv(wire.VARIABLE, raising=False)
    assert wire.read_key(None, "127.0.0.1", "--listen") == wire.LOOPBACK_KEY
    for host in ("192.0.2.1", "0.0.0.0"):
        with pytest.raises(WireError):
            wire.read_key(None, host, "--listen")
    monkeypatch.setenv(wire.VARIABLE, "of the environment")
    file = tmp_path / "key"
    file.write_text("of the file, longer\n")
    assert wire.read_key(None, "0.0.0.0", "--listen") == b"of the environment"
    assert wire.read_key(file, "0.0.0.0", "--listen") == b"of the file, longer"
    for wrong in (b"short", b"x" * 33, b"", b"\xff" * 20):
        file.write_bytes(wrong)
        with pytest.raises(WireError):
            wire.read_key(file, "127.0.0.1", "--listen")


@pytest.fixture
def peer(robot):
    with closing(Peer(robot)) as made:
        yield made


@pytest.mark.parametrize(("scenario", "said"), [(SCENARIO, "no controller"), (0, "no controller"), (8, "another scen")])
def test_run_does_not_start_with_packets_of_another_session_or_scenario(peer, scenario, said):
    peer.say(Kind.HELLO, scenario=scenario)
    peer.say(Kind.START, session=peer.session ^ 1)
    peer.say(Kind.COMMAND)
    with pytest.raises(WireError, match=said):
        peer.plant.start(peer.seen, *NOTHING)
    assert peer.link.quality["foreign"] == 2


def test_faulty_commands_are_counted(peer):
    peer.start()
    ones, quality = np.ones(peer.n), peer.link.quality
    peer.say(Kind.COMMAND, 0, tau=ones, limited=3, control_us=12.0, flags=wire.REPORTED, solve_us=2.0)
    np.testing.assert_array_equal(peer.tick(), ones)
    assert (peer.plant.limited, peer.columns["control_us"][0], peer.columns["solve_us"][0]) == (3, 12.0, 2.0)
    assert (quality["received"], quality["missed"]) == (1, 0)
    np.testing.assert_array_equal(peer.tick(), ones)  # the previous torque is held
    assert (quality["missed"], peer.plant.limited) == (1, 0)
    assert peer.columns["missed"][:2].tolist() == [False, True]
    peer.say(Kind.COMMAND, 1, tau=7 * ones)  # late
    peer.say(Kind.COMMAND, 4, tau=7 * ones)  # too early
    peer.say(Kind.COMMAND, 2, tau=np.nan * ones)
    np.testing.assert_array_equal(peer.tick(), ones)
    assert (quality["late"], quality["foreign"], quality["missed"]) == (1, 2, 2)
    peer.say(Kind.COMMAND, 3, tau=2 * ones, control_us=8.0, solve_us=5.0)  # without wire.REPORTED, solve_us is ignored
    peer.say(Kind.COMMAND, 3, tau=3 * ones)
    np.testing.assert_array_equal(peer.tick(), 2 * ones)
    assert (peer.columns["control_us"][3], np.isnan(peer.columns["solve_us"][3])) == (8.0, True)
    np.testing.assert_array_equal(peer.tick(), 2 * ones)
    assert (quality["received"], quality["missed"], quality["late"]) == (2, 3, 2)
    for _ in range(6):
        shown = np.frombuffer(peer.socket.recv(4096), layout(Kind.MEASUREMENT, peer.n)).reshape(())
    assert (shown["flags"], shown["sequence"]) == (wire.RUNNING, 4)
    np.testing.assert_array_equal(shown["commanded"], 2 * ones)
    peer.say(Kind.BYE)
    assert peer.plant.close() == quality | {"overruns": 0}


@pytest.mark.parametrize("wrong", [
    {"tau": 1e300}, {"tau": -500.0}, {"friction": -1.0}, {"limited": 8}, {"flags": wire.STOP, "friction": np.inf},
])  # fmt: skip
def test_unsafe_command_is_not_followed(peer, wrong):
    peer.start()
    held = peer.tick()
    peer.say(Kind.COMMAND, 1, **({"tau": 1.0} | wrong))
    np.testing.assert_array_equal(peer.tick(), held)
    assert (peer.link.quality["foreign"], peer.link.quality["missed"]) == (1, 2)
    assert not peer.plant.stop_reason


def test_watchdog_holds_then_damps_then_brakes(peer):
    peer.start()
    ones = np.ones(peer.n)
    peer.say(Kind.COMMAND, 0, tau=ones)
    peer.tick()
    for _ in range(SETTINGS.hold_ticks):
        np.testing.assert_array_equal(peer.tick(v=0.1), ones)
    for _ in range(SETTINGS.damp_ticks):
        tau = peer.tick(v=0.1)
        assert peer.plant.stop_reason == ""
    np.testing.assert_allclose(tau, peer.hold - 0.5, atol=1e-9)  # gravity torque minus 5 Nm s/rad times 0.1 rad/s
    peer.say(Kind.COMMAND, peer.k, tau=3 * ones)
    np.testing.assert_array_equal(peer.tick(), 3 * ones)
    for _ in range(SETTINGS.hold_ticks + SETTINGS.damp_ticks + 1):
        peer.tick()
    assert (peer.plant.brake_friction(peer.seen) > 0.0).all()
    peer.say(Kind.COMMAND, peer.k, tau=3 * ones)
    np.testing.assert_allclose(peer.tick(), peer.hold, atol=1e-9)  # the brakes stay closed
    assert peer.plant.stop_reason == "no command from the controller for 6 ticks"


def test_stop_by_the_controller_is_final(peer):
    peer.start()
    ones = np.ones(peer.n)
    peer.say(Kind.COMMAND, 0, tau=ones, flags=wire.STOP, reason=b"because\x1b", friction=2 * ones)
    peer.tick()
    peer.say(Kind.COMMAND, 1, tau=ones, friction=3 * ones)
    peer.tick()
    assert peer.plant.stop_reason == "because\ufffd"
    np.testing.assert_array_equal(peer.plant.brake_friction(peer.seen), 3 * ones)


N, TICKS = 3, 4


def measurement(flags, k=0, commanded=0.0, scenario=9):
    packet = make_packet(Kind.MEASUREMENT, N, 5, scenario)
    packet["flags"], packet["sequence"], packet["stamp"], packet["commanded"] = flags, k, k, commanded
    return packet


def answered(said):
    """Answer the packets `said`. Return ending, sent packets, and each set_applied_torque as (ticks so far, torque)."""
    said, sent, corrected, wait = iter(said), [], [], WireSettings(wait_s=0.05, silence_s=0.5)
    plant = Mock(n=N, peer=("plant", 1), session=0, quality=dict.fromkeys(wire.COUNTERS, 0), heard="nothing")
    plant.send.side_effect = lambda packet: sent.append((Kind(packet["kind"]), packet.copy()))
    plant.receive.side_effect = lambda until, wanted=lambda packet: True: next(filter(wanted, said), None)
    controller = Mock(spec=["start", "tick", "set_applied_torque", "columns", "note"])
    controller.tick.side_effect = (np.full(N, k) for k in count(1.0))  # the k-th command is k Nm
    controller.set_applied_torque.side_effect = lambda tau: corrected.append((controller.tick.call_count, tau.tolist()))
    controller.columns.return_value = {"solve_us": np.full(1, np.nan)}
    end = Answering(plant, wait, controller, None, np.zeros((TICKS, 3, 3)), np.zeros((TICKS, 2, 3)), scenario=9)
    return end.run(), sent, corrected


@pytest.mark.parametrize(("ticks", "commands", "corrected", "counts", "ended"), [
    ([(0, 0), (1, 1), (2, 2), (3, 3)], [(0, 1), (1, 2), (2, 3), (3, 4)], [], (4, 0, 0), "completed"),
    # The second command was lost: the controller is told that the first one acted again.
    ([(0, 0), (1, 1), (2, 1), (3, 3)], [(0, 1), (1, 2), (2, 3), (3, 4)], [(2, 1)], (4, 0, 0), "completed"),
    # A measurement is repeated.
    ([(0, 0), (1, 1), (1, 1)], [(0, 1), (1, 2), (1, 2)], [], (2, 0, 1), "the plant ended the run at tick 2 of 4"),
    ([(0, 0), (3, 1), (1, 1)], [(0, 1), (3, 2)], [], (2, 2, 1), "completed"),
])  # fmt: skip
def test_measurements_are_answered_and_counted(ticks, commands, corrected, counts, ended):
    """``ticks``: the sequence number of each measurement, and the torque [Nm] that it reports for the tick before."""
    last = measurement(wire.ENDED, max(ticks)[0])
    ending, packets, corrections = answered(
        [measurement(wire.WAITING), *(measurement(wire.RUNNING, k, tau) for k, tau in ticks), last]
    )
    sent = [packet for kind, packet in packets if kind is Kind.COMMAND]
    assert [(int(one["sequence"]), one["tau"].tolist()) for one in sent] == [(k, [tau] * N) for k, tau in commands]
    assert corrections == [(k, [tau] * N) for k, tau in corrected]
    assert tuple(ending["quality"][name] for name in ("received", "missed", "late")) == counts
    assert (ending["ended"], ending["ticks"]) == (ended, counts[0])
    assert packets[-1][0] is Kind.BYE
    assert {int(one["flags"]) for one in sent} == {wire.REPORTED}


@pytest.mark.parametrize("said", [[measurement(wire.WAITING, scenario=8)], [], [measurement(wire.RUNNING)] * 100])
def test_plant_not_ready_for_this_scenario_is_refused(said):
    with pytest.raises(WireError):
        answered(said)


def test_measurement_with_impossible_stamp_is_not_answered():
    odd = measurement(wire.RUNNING, 1)
    odd["stamp"] = -(2**63)
    ending, _, _ = answered([measurement(wire.WAITING), measurement(wire.RUNNING), odd, measurement(wire.ENDED, 1)])
    assert (ending["quality"]["foreign"], ending["quality"]["received"]) == (1, 1)


def test_clock_is_shifted_only_after_a_delay_above_one_period(monkeypatch):
    T = 0.002
    now = {"s": 100.0, "oversleep": 0.5 * T}
    monkeypatch.setattr(clock, "monotonic", lambda: now["s"])
    monkeypatch.setattr(clock, "sleep", lambda seconds: now.update(s=now["s"] + seconds + now["oversleep"]))
    time = clock.WallClock(T)
    assert time.wait_for(0) == pytest.approx(100.0 + 2.5 * T)  # tick 0 is half a period late
    assert time.late_us == pytest.approx(1e6 * 0.5 * T)
    now["oversleep"] = 0.0
    for tick in range(1, 20):
        until = time.wait_for(tick)
        assert (now["s"], until) == (pytest.approx(100.0 + (1 + tick) * T), pytest.approx(now["s"] + T))
        now["s"] += T * (0.1 + 0.8 * (tick % 2))
    assert time.overruns == 0
    now["s"] = 100.0 + 30.0 * T
    time.wait_for(20)
    assert (time.overruns, time.late_us) == (1, pytest.approx(1e6 * 9 * T))
    time.wait_for(21)
    assert (now["s"], time.overruns) == (pytest.approx(100.0 + 31.0 * T), 1)


def test_child_processes_have_no_realtime_priority(monkeypatch):
    asked = []
    monkeypatch.setattr(clock.os, "sched_setscheduler", lambda pid, policy, parameter: asked.append(policy))
    monkeypatch.setattr(clock.os, "sched_getscheduler", lambda pid: asked[-1])
    monkeypatch.setattr(clock.ctypes, "CDLL", lambda *a, **k: Mock())
    clock.ask_for_realtime()
    clock.give_back_realtime()
    assert asked == [os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.SCHED_OTHER]
