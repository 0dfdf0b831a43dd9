"""The packets: of fixed size, with little-endian numbers and a keyed checksum at the end, for Python and for C.

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

MAGIC, VERSION = b"MOCW", 2
LOOPBACK_KEY = b"moc_opt: loopback, no secret"
TAG_BYTES = 16
Packet = NDArray[np.void]  #: Of shape (); ``packet["q"]`` is a view of its bytes.
COUNTERS = ("received", "missed", "late", "forged", "foreign")
"""What an end counts; docs/realtime.md says what each is."""


class Kind(IntEnum):
    """The kinds of packet; all but MEASUREMENT go to the plant."""

    HELLO = 1  #: Answered by one measurement.
    START = 2  #: The controller has started at that measurement: begin.
    MEASUREMENT = 3
    COMMAND = 4
    BYE = 5  #: The end of the run is acknowledged, with what the controller has to say of it.


WAITING, RUNNING, ENDED = 0, 1, 2  #: ``flags`` of a measurement: nothing moves yet; a command is expected; the end.
STOP, REPORTED = 1, 2  #: Bits in ``flags`` of a command: brake the arm; it holds the third level's results.

HEADER: list[tuple[Any, ...]] = [
    ("magic", "S4"), ("version", "u1"), ("kind", "u1"), ("joints", "u1"), ("flags", "u1"), ("session", "<u8"),
    ("scenario", "<u8"), ("sequence", "<i8"),
]  # fmt: skip


@cache
def layout(kind: Kind, n: int) -> np.dtype[Any]:
    """Return the bytes of a packet for n joints."""
    bodies: dict[Kind, list[tuple[Any, ...]]] = {
        Kind.MEASUREMENT: [
            ("stamp", "<i8"), ("q", "<f8", (n,)), ("v", "<f8", (n,)), ("wrench", "<f8", (6,)),
            ("commanded", "<f8", (n,)),
        ],
        Kind.COMMAND: [
            ("tau", "<f8", (n,)), ("friction", "<f8", (n,)), ("control_us", "<f8"), ("limited", "<u4"),
            ("iterations", "<i4"), ("reason", "S96"), ("status", "S16"), ("fault", "S16"), ("solve_us", "<f8"),
            ("x_rad_per_s", "<f8", (n,)), ("applied_x_rad_per_s", "<f8", (n,)), ("dual", "<f8", (6,)),
            ("subproblem", "<f8", (offsets(n).end,)),
        ],
        Kind.BYE: [("words", "S8000")],
    }  # fmt: skip
    return np.dtype([*HEADER, *bodies.get(kind, []), ("tag", f"V{TAG_BYTES}")])


def tag(data: bytes, key: bytes) -> bytes:
    """Return the keyed check of a packet less its last 16 bytes: BLAKE2s (RFC 7693) with a key."""
    return hashlib.blake2s(data, key=key, digest_size=TAG_BYTES).digest()


def sealed(data: bytes, key: bytes) -> bool:
    """Say whether a packet ends with its check."""
    return hmac.compare_digest(tag(data[:-TAG_BYTES], key), data[-TAG_BYTES:])


def make_packet(kind: Kind, n: int, session: int = 0, scenario: int = 0) -> Packet:
    """Make a packet of zeros but for its header.

    Args:
        session: drawn by the plant when it is started; 0: not known yet.
        scenario: fingerprint of the settings that both ends must share.
    """
    packet = np.zeros((), layout(kind, n))
    packet["magic"], packet["version"], packet["kind"], packet["joints"] = MAGIC, VERSION, kind, n
    packet["session"], packet["scenario"] = session, scenario
    return packet


def seal(packet: Packet, key: bytes) -> bytes:
    """Return the bytes of a packet with their check."""
    data = packet.tobytes()[:-TAG_BYTES]
    return data + tag(data, key)


_C_TYPES = {
    "f8": "double", "u1": "uint8_t", "u4": "uint32_t", "i4": "int32_t", "u8": "uint64_t", "i8": "int64_t", "S": "char",
    "V": "uint8_t",
}  # fmt: skip


def _c_struct(name: str, whole: np.dtype[Any], head: str) -> str:
    fields = [f"    {head} head;"] if head else []
    for field in (whole.names or ())[len(HEADER) if head else 0 :]:
        of = whole[field]
        base, count = of.base, of.itemsize // of.base.itemsize
        if base.kind in "SV":
            base, count = np.dtype(base.kind), base.itemsize
        size = f"[{count}]" if of.shape or base.itemsize == 0 else ""
        fields.append(f"    {_C_TYPES[base.str[1:].removesuffix('0')]} {field}{size};")
    check = f'_Static_assert(sizeof({name}) == {whole.itemsize}, "{name}");'
    return "\n".join(["typedef struct {", *fields, f"}} {name};", check])


def c_packets(n: int, ticks: int, scenario: int, wait_s: float, silence_s: float) -> str:
    """Write ``wire_packets.h`` of an exported controller: a struct for every kind of packet, and the wire's numbers.

    ``ticks`` and the fingerprint ``scenario`` are of the run, ``wait_s`` and ``silence_s`` of ``[wire]``.
    """
    defines = {
        "JOINTS": n, "TICKS": ticks, "SCENARIO": f"UINT64_C({scenario})", "VERSION": VERSION,
        "MAGIC": f'"{MAGIC.decode()}"', "LOOPBACK_KEY": f'"{LOOPBACK_KEY.decode()}"', "WAIT_S": wait_s,
        "SILENCE_S": silence_s, "WAITING": WAITING, "RUNNING": RUNNING, "ENDED": ENDED, "STOP": STOP,
        "REPORTED": REPORTED, **{f"KIND_{kind.name}": int(kind) for kind in Kind},
    }  # fmt: skip
    structs = {f"wire_{kind.name.lower()}": layout(kind, n) for kind in Kind}
    return "\n".join([
        "/* The packets of the wire and its numbers, written by moc_opt/realtime/packets.py; see docs/realtime.md. */",
        "#include <stdint.h>",
        "#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__",
        '#error "the packets are little-endian"',
        "#endif",
        *(f"#define WIRE_{name} {value}" for name, value in defines.items()),
        f"enum {{ {', '.join(f'WIRE_{name.upper()}' for name in COUNTERS)}, WIRE_COUNTERS }};",
        _c_struct("wire_header", np.dtype(HEADER), ""),
        *(_c_struct(name, whole, "wire_header") for name, whole in structs.items()), "",
    ])  # fmt: skip
