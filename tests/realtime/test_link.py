"""The socket that lets sound packets through, and the memory of sequence numbers."""

from __future__ import annotations

import socket
from time import monotonic

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.realtime.key import WireError
from moc_opt.realtime.link import BACKLOG, Link, Sequence
from moc_opt.realtime.packets import Kind, Packet

KEY = b"k" * 16


@pytest.fixture
def ends():
    plant = Link(7, KEY, (Kind.COMMAND, Kind.HELLO), listen=("127.0.0.1", 0))
    controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    controller.bind(("127.0.0.1", 0))
    yield plant, controller
    plant.close()
    controller.close()


def command(**changes):
    packet = Packet(changes.pop("kind", Kind.COMMAND), changes.pop("n", 7), changes.pop("session", 4))
    for name, value in changes.items():
        packet[name] = value
    return packet


def test_sound_packets_pass_and_all_others_are_counted(ends):
    plant, controller = ends
    plant.session, plant.peer = 4, controller.getsockname()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(command(sequence=1).seal(KEY), plant.address)  # foreign: not the one that began the session
        for data in (
            command(sequence=2).seal(b"l" * 16),  # forged
            command(sequence=3).seal(KEY)[:-1],  # truncated, as the next three
            command(sequence=3).seal(KEY) + b"\0",
            b"",
            command(n=6).seal(KEY),
            command(session=5).seal(KEY),  # foreign, as the next four
            command(magic=b"XXXX").seal(KEY),
            command(version=9).seal(KEY),
            command(joints=6).seal(KEY),
            command(kind=Kind.MEASUREMENT).seal(KEY),  # the plant's own, come back
            command(sequence=8).seal(KEY),  # sound
        ):
            controller.sendto(data, plant.address)
        found = plant.receive(monotonic() + 5.0)
    assert found is not None
    assert found["sequence"] == 8
    assert plant.sender == controller.getsockname()
    assert plant.receive(monotonic()) is None
    counts = plant.quality
    assert (counts.forged, counts.truncated, counts.foreign) == (1, 4, 6)
    assert counts.values() == [0, 0, 0, 0, 0, 4, 1, 6]


def test_what_has_arrived_is_taken_after_the_time_too_but_a_flood_ends(ends):
    plant, controller = ends
    controller.sendto(command(sequence=1).seal(KEY), plant.address)
    assert plant.receive(monotonic() - 1.0) is not None
    for _ in range(BACKLOG):
        controller.sendto(b"x", plant.address)
    controller.sendto(command(sequence=2).seal(KEY), plant.address)
    taken = plant.receive(monotonic() - 1.0)  # the system's buffer may hold fewer
    assert taken is None
    assert plant.quality.truncated == BACKLOG


def test_who_does_not_listen_loses_packets_and_nothing_else(ends):
    plant, controller = ends
    gone = controller.getsockname()
    controller.close()
    for _ in range(3):
        plant.send(Packet(Kind.MEASUREMENT, 7), gone)
    assert plant.receive(monotonic() + 0.05) is None


def test_an_address_is_taken_once(ends):
    with pytest.raises(WireError, match="cannot be taken"):
        Link(7, KEY, (), listen=ends[0].address)


@given(st.lists(st.integers(0, 150), max_size=60))
def test_sequence_numbers(numbers):
    """As a set of all that came would judge, but for what lies far back."""
    sequence, came = Sequence(), set()
    for number in numbers:
        newest = max(came, default=-1)
        expected = (
            "new" if number > newest else "old" if newest - number >= 64
            else "doubled" if number in came else "reordered"
        )  # fmt: skip
        assert sequence.judge(number) == expected
        sequence.take(number)
        came.add(number)
        assert sequence.newest == max(came)
