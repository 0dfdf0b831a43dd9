"""The packets: of fixed size, with little-endian numbers and a keyed checksum at the end.

Every layout is a numpy dtype; docs/realtime.md has them as tables. All fields lie at multiples of their size, so that
a C struct of the same fields has the same bytes.
"""

from __future__ import annotations

import hashlib
import hmac
from enum import IntEnum
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.qp.layout import offsets

MAGIC, VERSION = b"MOCW", 1
TAG_BYTES = 16
REASON_BYTES, WORDS_BYTES = 96, 3000
COUNTERS = ("received", "missed", "late", "doubled", "reordered", "truncated", "forged", "foreign")
"""The quality counters of an end, in the order of the packet; ``link.Quality`` says what each counts."""


class Kind(IntEnum):
    """The kinds of packet."""

    HELLO = 1
    """To the plant: show yourself. Answered by one measurement."""
    START = 2
    """To the plant: the controller has started at that measurement; begin."""
    MEASUREMENT = 3
    COMMAND = 4
    REPORT = 5
    """To the plant, after a command: the third level's results, only for the trace."""
    BYE = 6
    """To the plant: the end of the run is acknowledged, with the controller's counts."""


WAITING, RUNNING, ENDED = 0, 1, 2
"""``flags`` of a measurement: nothing moves yet; a command is expected; the run is over."""
STOP, REPORTED = 1, 2
"""Bits in ``flags`` of a command: brake the arm; a report follows."""

HEADER: list[tuple[Any, ...]] = [
    ("magic", "S4"), ("version", "u1"), ("kind", "u1"), ("joints", "u1"), ("flags", "u1"), ("session", "<u8"),
    ("scenario", "<u8"), ("sequence", "<i8"), ("sent_ns", "<i8"),
]  # fmt: skip


@cache
def layout(kind: Kind, n: int) -> np.dtype[Any]:
    """Return the bytes of a packet for n joints."""
    bodies: dict[Kind, list[tuple[Any, ...]]] = {
        Kind.MEASUREMENT: [
            ("stamp", "<i8"), ("q", "<f8", (n,)), ("v", "<f8", (n,)), ("wrench", "<f8", (6,)),
            ("commanded", "<f8", (n,)), ("counters", "<u4", (len(COUNTERS),)),
        ],
        Kind.COMMAND: [
            ("tau", "<f8", (n,)), ("friction", "<f8", (n,)), ("control_us", "<f8"), ("limited", "<u4"),
            ("spare", "<u4"), ("reason", f"S{REASON_BYTES}"),
        ],
        Kind.REPORT: [
            ("solve_us", "<f8"), ("x_rad_per_s", "<f8", (n,)), ("applied_x_rad_per_s", "<f8", (n,)),
            ("dual", "<f8", (6,)), ("subproblem", "<f8", (offsets(n).end,)), ("iterations", "<i4"), ("spare", "<u4"),
            ("status", "S16"), ("fault", "S16"),
        ],
        Kind.BYE: [("words", f"S{WORDS_BYTES}")],
    }  # fmt: skip
    return np.dtype([*HEADER, *bodies.get(kind, []), ("tag", f"V{TAG_BYTES}")])


def tag(data: bytes | bytearray | memoryview, key: bytes) -> bytes:
    """Return the keyed check of a packet less its last 16 bytes: BLAKE2s (RFC 7693) with a key."""
    return hashlib.blake2s(data, key=key, digest_size=TAG_BYTES).digest()


def sealed(data: bytearray | memoryview, key: bytes) -> bool:
    """Say whether a packet ends with its check."""
    return hmac.compare_digest(tag(data[:-TAG_BYTES], key), bytes(data[-TAG_BYTES:]))


class Packet:
    """One packet of a kind; ``packet["q"]`` is a view of its bytes, a scalar being an array of shape ().

    Args:
        kind: which.
        session: drawn by the plant when it is started; 0: not known yet.
        scenario: fingerprint of the settings that both ends must share.
    """

    def __init__(self, kind: Kind, n: int, session: int = 0, scenario: int = 0) -> None:
        dtype = layout(kind, n)
        self.kind, self.buffer = kind, bytearray(dtype.itemsize)
        whole = np.frombuffer(self.buffer, dtype).reshape(())
        self._fields: dict[str, NDArray[Any]] = {name: whole[name] for name in dtype.names or ()}
        for name, value in {
            "magic": MAGIC, "version": VERSION, "kind": kind, "joints": n, "session": session, "scenario": scenario,
        }.items():  # fmt: skip
            self[name] = value

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._fields[name]

    def __setitem__(self, name: str, value: Any) -> None:
        self._fields[name][...] = value

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def seal(self, key: bytes) -> bytearray:
        """Write the check, and return the bytes."""
        self.buffer[-TAG_BYTES:] = tag(memoryview(self.buffer)[:-TAG_BYTES], key)
        return self.buffer
