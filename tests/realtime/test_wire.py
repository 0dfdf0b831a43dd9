"""Packets: their bytes are what docs/realtime.md says, any change breaks the check, and only sound ones pass."""

import re
import socket
from pathlib import Path
from time import monotonic

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.realtime import wire
from moc_opt.realtime.wire import Kind, Link, WireError, layout, make_packet, read_key, seal, sealed

PAGE = (Path(__file__).parents[2] / "docs" / "realtime.md").read_text(encoding="utf-8")
KINDS = (Kind.MEASUREMENT, Kind.COMMAND)
KEY = b"sixteen bytes or more"


def table(mark: str) -> list[tuple[int, str, str]]:
    """Offset, field and type of the rows of a table of the page."""
    text = PAGE.partition(f"<!-- {mark} -->\n")[2].partition("\n\n")[0]
    return [(int(a), b, c) for a, b, c in re.findall(r"^\| (\d+) \| (\w+) \| ([^|]+) \|", text, re.MULTILINE)]


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_has_every_field_where_it_lies(kind):
    dtype, times = layout(kind, 7), {(): "", (7,): " x n", (6,): " x 6", (87,): " x (11 n + 10)"}
    fields = [(at, name, of.base.str.lstrip("<|") + times[of.shape]) for name, (of, at) in dtype.fields.items()]
    assert table("header") + table(kind.name) == fields[:-1]
    assert f"{kind.name} ({dtype.itemsize} bytes)" in PAGE
    assert f"{int(kind)} {kind.name}" in PAGE


@given(st.sampled_from(KINDS), st.data())
def test_one_changed_bit_breaks_the_check(kind, data):
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
    controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    controller.bind(("127.0.0.1", 0))
    yield plant, controller
    plant.close()
    controller.close()


def command(kind=Kind.COMMAND, n=7, session=4, **changes):
    packet = make_packet(kind, n, session)
    for name, value in changes.items():
        packet[name] = value
    return packet


def test_sound_packets_pass_and_all_others_are_counted(ends):
    plant, controller = ends
    plant.session, plant.peer = 4, controller.getsockname()
    foreign = (
        seal(command(sequence=3), KEY)[:-1], seal(command(sequence=3), KEY) + b"\0", b"", seal(command(n=6), KEY),
        seal(command(session=5), KEY), seal(command(magic=b"OTHR"), KEY), seal(command(version=9), KEY),
        seal(command(joints=6), KEY), seal(command(kind=Kind.MEASUREMENT), KEY),  # the plant's own, come back
    )  # fmt: skip
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(seal(command(sequence=1), KEY), plant.address)  # not the one that began the session
        for data in (seal(command(sequence=2), b"l" * 16), *foreign, seal(command(sequence=8), KEY)):
            controller.sendto(data, plant.address)
        found = plant.receive(monotonic() + 5.0)
    assert found["sequence"] == 8
    assert plant.sender == controller.getsockname()
    assert plant.receive(monotonic()) is None
    assert plant.quality == {"received": 0, "missed": 0, "late": 0, "forged": 1, "foreign": 1 + len(foreign)}


def test_what_has_arrived_is_taken_after_the_time_too_but_a_flood_ends(ends):
    plant, controller = ends
    controller.sendto(seal(command(sequence=1), KEY), plant.address)
    assert plant.receive(monotonic() - 1.0) is not None
    for flood in (b"x", seal(command(sequence=2), KEY)):  # unsound packets, and sound ones that nobody wants
        for _ in range(wire.BACKLOG):  # the system's buffer may hold fewer
            controller.sendto(flood, plant.address)
        controller.sendto(seal(command(sequence=3), KEY), plant.address)
        assert plant.receive(monotonic() - 1.0, lambda packet: packet["sequence"] == 3) is None
        while plant.receive(monotonic()) is not None:
            pass
    assert plant.quality["foreign"] == wire.BACKLOG


def test_an_address_is_read_or_refused():
    assert wire.parse_address("127.0.0.1:30200", "--listen") == ("127.0.0.1", 30200)
    assert wire.parse_address("localhost:0", "--listen") == ("127.0.0.1", 0)
    for wrong in ("30200", "127.0.0.1", ":30200", "1.1.1.1:x", "1.1.1.1:70000", "no host.invalid:1"):
        with pytest.raises(WireError):
            wire.parse_address(wrong, "--listen")


def test_a_key_comes_from_the_file_or_else_from_the_environment_and_other_machines_need_one(tmp_path, monkeypatch):
    monkeypatch.delenv(wire.VARIABLE, raising=False)
    assert read_key(None, "127.0.0.1", "--listen") == wire.LOOPBACK_KEY
    for host in ("192.0.2.1", "0.0.0.0"):
        with pytest.raises(WireError):
            read_key(None, host, "--listen")
    monkeypatch.setenv(wire.VARIABLE, "of the environment")
    file = tmp_path / "key"
    file.write_text("of the file, longer\n")
    assert read_key(None, "0.0.0.0", "--listen") == b"of the environment"
    assert read_key(file, "0.0.0.0", "--listen") == b"of the file, longer"
    for wrong in (b"short", b"x" * 33, b"", b"\xff" * 20):
        file.write_bytes(wrong)
        with pytest.raises(WireError):
            read_key(file, "127.0.0.1", "--listen")
