"""The bytes of packets: what docs/realtime.md says, and a check that any change breaks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.realtime.packets import HEADER, TAG_BYTES, Kind, Packet, layout, sealed, tag

PAGE = (Path(__file__).parents[2] / "docs" / "realtime.md").read_text(encoding="utf-8")
KINDS = (Kind.MEASUREMENT, Kind.COMMAND, Kind.REPORT)
KEY = b"sixteen bytes or more"


def table(mark: str) -> list[tuple[int, str, str]]:
    """Offset, field and type of the rows of a table of the page."""
    text = PAGE.partition(f"<!-- {mark} -->\n")[2].partition("\n\n")[0]
    return [(int(a), b, c) for a, b, c in re.findall(r"^\| (\d+) \| (\w+) \| ([^|]+) \|", text, re.MULTILINE)]


def spelled(dtype: np.dtype) -> str:
    base, shape = (dtype.subdtype or (dtype, ()))[0], dtype.shape
    times = {(): "", (7,): " x n", (6,): " x 6", (8,): " x 8", (80,): " x (10 n + 10)"}[shape]
    return base.str.lstrip("<|") + times


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_has_every_field_where_it_lies(kind):
    dtype = layout(kind, 7)
    fields = [(dtype.fields[name][1], name, spelled(dtype.fields[name][0])) for name in dtype.names]
    assert table("header") + table(kind.name) == fields[:-1]
    assert f"{kind.name} ({dtype.itemsize} bytes)" in PAGE
    assert f"{int(kind)} {kind.name}" in PAGE


@pytest.mark.parametrize("kind", Kind)
@pytest.mark.parametrize("n", range(6, 21))
def test_a_c_struct_of_the_same_fields_has_the_same_bytes(kind, n):
    """Every field at a multiple of its size: no compiler puts anything between them."""
    dtype = layout(kind, n)
    for name in dtype.names:
        field, offset = dtype.fields[name]
        assert offset % (1 if field.base.kind in "SV" else field.base.itemsize) == 0
    assert dtype.itemsize % 8 == 0
    assert dtype.names[: len(HEADER)] == tuple(entry[0] for entry in HEADER)


def test_the_check_is_that_of_the_rfc():
    """Known answers of keyed BLAKE2s, from the reference implementation's list, cut by its own parameter."""
    assert tag(b"", KEY) != tag(b"", KEY + b"x") != tag(b"\0", KEY + b"x")
    from hashlib import blake2s

    key = bytes(range(32))
    assert blake2s(b"", key=key).hexdigest() == "48a8997da407876b3d79c0d92325ad3b89cbb754d86ab71aee047ad345fd2c49"
    assert len(tag(b"abc", key)) == TAG_BYTES


@given(st.sampled_from(KINDS), st.data())
def test_one_changed_bit_breaks_the_check(kind, data):
    packet = Packet(kind, 7, session=5, scenario=9)
    sent = packet.seal(KEY)
    assert sealed(sent, KEY)
    bit = data.draw(st.integers(0, 8 * len(sent) - 1))
    changed = bytearray(sent)
    changed[bit // 8] ^= 1 << bit % 8
    assert not sealed(changed, KEY)
    assert not sealed(sent, KEY[:-1] + b"x")


def test_what_is_written_is_read_from_the_bytes():
    one = Packet(Kind.MEASUREMENT, 7, session=2**63 - 1, scenario=3)
    one["q"], one["sequence"], one["counters"] = np.arange(7.0), 123456789012, range(8)
    two = Packet(Kind.MEASUREMENT, 7)
    two.buffer[:] = one.seal(KEY)
    assert two["q"].tolist() == list(range(7))
    assert two["counters"].tolist() == list(range(8))
    assert (int(two["sequence"]), int(two["session"]), int(two["scenario"])) == (123456789012, 2**63 - 1, 3)
    assert bytes(two.buffer[48:56]) == bytes(8)
    assert np.frombuffer(two.buffer[56:64], "<f8") == 1.0
    command = Packet(Kind.COMMAND, 7)
    command["reason"] = b"x" * 200
    assert bytes(command["reason"][()]) == b"x" * 96
