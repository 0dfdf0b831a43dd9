"""The wire: UDP packets between plant and controller, and a socket that drops invalid packets.

A packet ends with the keyed BLAKE2s checksum (RFC 7693) of all preceding bytes. Nothing is encrypted.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import select
import socket
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from ipaddress import ip_address
from pathlib import Path
from time import monotonic
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moc_opt.errors import MocOptError, describe
from moc_opt.inputs.files import read_text
from moc_opt.inputs.settings import Settings
from moc_opt.qp.problem import row_length

MAGIC, VERSION = b"MOCW", 3
LOOPBACK_KEY = b"moc_opt: loopback, no secret"
VARIABLE = "MOC_OPT_WIRE_KEY"  #: Environment variable with the key.
SHORTEST, LONGEST = 16, 32  #: Bounds on a key's length [bytes].
TAG_BYTES = 16
BACKLOG = 256  #: After its time limit, `receive` reads waiting packets only until it has read this many since its call.
COUNTERS = ("received", "missed", "late", "forged", "foreign")
"""What plant and controller each count: packets used (received), ticks without a packet in time (missed), late or
repeated packets (late), packets with a wrong checksum (forged), and all other ignored packets (foreign)."""

Packet = NDArray[np.void]  #: A record of shape ().
Address = tuple[str, int]


class WireError(MocOptError, RuntimeError):
    """The wire cannot be set up, or the other end does not answer."""


class WireSettings(Settings):
    """Time-outs of `moc-opt plant` and `moc-opt control`, and the plant's reaction to missing commands."""

    KIND: ClassVar[str] = "[wire]"
    ERROR: ClassVar[type[MocOptError]] = WireError

    hold_ticks: int = Field(5, ge=0)
    """number of control periods without a command for which the last torque acts"""
    damp_ticks: int = Field(50, ge=0)
    """number of control periods after `hold_ticks` for which the drives carry and damp the arm. Then the brakes
    close"""
    damping_Nm_s_per_rad: float = Field(5.0, gt=0.0, le=1e3, description="damping of each joint during `damp_ticks`")
    wait_s: float = Field(60.0, gt=0.0, description="time for which plant and controller wait for each other to start")
    silence_s: float = Field(5.0, gt=0.0, description="time without a measurement after which the controller ends")
    resend_s: float = Field(0.2, gt=0.0)
    """time after which an unanswered measurement is sent again, with `moc-opt plant --lock-step`"""
    resends: int = Field(20, ge=0)
    """number of times that an unanswered measurement is sent again, with `moc-opt plant --lock-step`"""


# --- packets ---


class Kind(IntEnum):
    """Only a MEASUREMENT goes to the controller, all others go to the plant."""

    HELLO = 1  #: Looks for a plant.
    START = 2  #: Lets the plant begin.
    MEASUREMENT = 3
    COMMAND = 4
    BYE = 5  #: Confirms the end of the run.


WAITING, RUNNING, ENDED = 0, 1, 2  #: ``flags`` of a measurement: before, during and after the run.
STOP, REPORTED = 1, 2
"""Bits in ``flags`` of a command. REPORTED: "iterations" and all fields after "reason" are set."""

# Every field's offset is a multiple of its size, as in a C struct. "scenario" is a hash of the scenario.
HEADER: list[tuple[Any, ...]] = [
    ("magic", "S4"), ("version", "u1"), ("kind", "u1"), ("joints", "u1"), ("flags", "u1"), ("session", "<u8"),
    ("scenario", "<u8"), ("sequence", "<i8"),
]  # fmt: skip


@cache
def layout(kind: Kind, n: int) -> np.dtype[Any]:
    """Return the byte layout of a packet for n joints. docs/realtime.md explains the fields."""
    bodies: dict[Kind, list[tuple[Any, ...]]] = {
        Kind.MEASUREMENT: [
            ("stamp", "<i8"), ("q", "<f8", (n,)), ("v", "<f8", (n,)), ("wrench", "<f8", (6,)),
            ("commanded", "<f8", (n,)),
        ],
        Kind.COMMAND: [
            ("tau", "<f8", (n,)), ("friction", "<f8", (n,)), ("control_us", "<f8"), ("limited", "<u4"),
            ("iterations", "<i4"), ("reason", "S96"), ("status", "S16"), ("fault", "S16"), ("solve_us", "<f8"),
            ("x_rad_per_s", "<f8", (n,)), ("applied_x_rad_per_s", "<f8", (n,)), ("dual", "<f8", (6,)),
            ("subproblem", "<f8", (row_length(n),)),
        ],
    }  # fmt: skip
    return np.dtype([*HEADER, *bodies.get(kind, []), ("tag", f"V{TAG_BYTES}")])


def make_packet(kind: Kind, n: int, session: int = 0, scenario: int = 0) -> Packet:
    """Make a packet whose flags, sequence and body are 0."""
    packet = np.zeros((), layout(kind, n))
    packet["magic"], packet["version"], packet["kind"], packet["joints"] = MAGIC, VERSION, kind, n
    packet["session"], packet["scenario"] = session, scenario
    return packet


def seal(packet: Packet, key: bytes) -> bytes:
    """Return a packet's bytes with their checksum."""
    data = packet.tobytes()[:-TAG_BYTES]
    return data + hashlib.blake2s(data, key=key, digest_size=TAG_BYTES).digest()


def sealed(data: bytes, key: bytes) -> bool:
    """Return whether a packet ends with the right checksum."""
    wanted = hashlib.blake2s(data[:-TAG_BYTES], key=key, digest_size=TAG_BYTES).digest()
    return hmac.compare_digest(wanted, data[-TAG_BYTES:])


def _c_struct(name: str, whole: np.dtype[Any], head: str) -> str:
    fields = [f"    {head} head;"] if head else []
    for field in (whole.names or ())[len(HEADER) if head else 0 :]:
        kind, bits, total = whole[field].base.kind, 8 * whole[field].base.itemsize, 8 * whole[field].itemsize
        text, sign = kind in "SV", "u" if kind == "u" else ""
        c_type = {"f": "double", "S": "char", "V": "uint8_t"}.get(kind, f"{sign}int{bits}_t")
        count = total // (8 if text else bits)
        fields.append(f"    {c_type} {field}{f'[{count}]' if count > 1 else ''};")
    check = f'_Static_assert(sizeof({name}) == {whole.itemsize}, "{name}");'
    return "\n".join(["typedef struct {", *fields, f"}} {name};", check])


def c_packets(n: int, ticks: int, scenario: int, settings: WireSettings) -> str:
    """Return the text of ``wire_packets.h``."""
    defines = {
        "JOINTS": n, "TICKS": ticks, "SCENARIO": f"UINT64_C({scenario})", "VERSION": VERSION,
        "MAGIC": f'"{MAGIC.decode()}"', "LOOPBACK_KEY": f'"{LOOPBACK_KEY.decode()}"', "WAIT_S": settings.wait_s,
        "SILENCE_S": settings.silence_s, "WAITING": WAITING, "RUNNING": RUNNING, "ENDED": ENDED, "STOP": STOP,
        "REPORTED": REPORTED, **{f"KIND_{kind.name}": int(kind) for kind in Kind},
    }  # fmt: skip
    return "\n".join([
        "/* The packets and numbers of the wire, written by moc_opt/realtime/wire.py; see docs/realtime.md. */",
        "#include <stdint.h>",
        "#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__",
        '#error "the packets are little-endian"',
        "#endif",
        *(f"#define WIRE_{name} {value}" for name, value in defines.items()),
        _c_struct("wire_header", np.dtype(HEADER), ""),
        *(_c_struct(f"wire_{kind.name.lower()}", layout(kind, n), "wire_header") for kind in Kind), "",
    ])  # fmt: skip


# --- address and key ---


def written(address: Address | None) -> str:
    """Return an address as "HOST:PORT"; None becomes "nobody"."""
    return "nobody" if address is None else f"{address[0]}:{address[1]}"


def parse_address(text: str, option: str) -> Address:
    """Return IPv4 address and port of "HOST:PORT". Raise a WireError if form or host is wrong."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise WireError(f"{option} {text!r}: give HOST:PORT, as 127.0.0.1:30200")
    try:
        found = socket.getaddrinfo(host, None, family=socket.AF_INET, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise WireError(f"{option} {text!r}: no such host ({error})") from error
    return str(found[0][4][0]), int(port)


def read_key(file: Path | None, host: str, option: str) -> bytes:
    """Return the key in ``file`` or, if it is None, in `VARIABLE`. On loopback, the default is `LOOPBACK_KEY`.

    Raises:
        WireError: there is no key, or its length is wrong.
    """
    text = os.environ.get(VARIABLE, "") if file is None else read_text(file, "--key-file", WireError)
    if file is None and not text:
        if ip_address(host).is_loopback:
            return LOOPBACK_KEY
        raise WireError(
            f"{option} {host}: other machines reach that address, and any of them can move the arm: give both "
            f"ends the same key by --key-file or {VARIABLE}, or use 127.0.0.1"
        )
    key = (text if file is None else text.strip()).encode(errors="surrogateescape")  # udp.c does not strip the variable
    if not SHORTEST <= len(key) <= LONGEST:
        raise WireError(
            f"{VARIABLE if file is None else f'--key-file {str(file)!r}'}: a key of {len(key)} bytes: give one line of "
            f"{SHORTEST} to {LONGEST} bytes, such as the output of `openssl rand -hex 16`"
        )
    return key


class Link:
    """A socket for sealed packets. Raises a WireError if the address cannot be bound.

    It listens at ``address`` and sends to ``peer``. ``expected`` are the kinds of packets that it may receive. If
    ``session`` is not 0, only packets of this session from ``peer`` are valid. ``sender`` is the address of the
    latest valid packet. ``quality`` has the counts named in ``COUNTERS``.
    """

    def __init__(
        self, n: int, key: bytes, expected: tuple[Kind, ...], listen: Address | None = None, peer: Address | None = None
    ) -> None:
        self.n, self.peer, self.session = n, peer, 0
        self.quality, self.sender = dict.fromkeys(COUNTERS, 0), peer
        self._key, self._incoming = key, {int(kind): make_packet(kind, n) for kind in expected}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.close = self._socket.close
        try:
            if listen is not None:
                self._socket.bind(listen)
            self._socket.setblocking(False)
        except OSError as error:
            self.close()
            raise WireError(f"the address {written(listen)} cannot be taken: {error.strerror}; give another") from error
        self.address: Address = self._socket.getsockname()

    @property
    def heard(self) -> str:
        """The counts in words."""
        return ", ".join(f"{name} {count}" for name, count in self.quality.items() if count) or "nothing came"

    def send(self, packet: Packet, to: Address | None = None) -> None:
        """Seal a packet and send it."""
        try:
            self._socket.sendto(seal(packet, self._key), to or self.peer)  # type: ignore[arg-type]
        except (BlockingIOError, ConnectionError):
            pass
        except OSError as error:
            raise WireError(f"nothing can be sent to {written(to or self.peer)}: {describe(error)}") from error

    def receive(self, until: float, wanted: Callable[[Packet], bool] = lambda packet: True) -> Packet | None:
        """Return the next valid packet for which ``wanted`` is true, or None if `monotonic` reaches ``until`` [s]."""
        looked_at = 0
        while looked_at < BACKLOG or monotonic() < until:
            try:
                data, sender = self._socket.recvfrom(16384)
            except BlockingIOError:
                left = until - monotonic()
                if left <= 0.0:
                    return None
                select.select([self._socket], [], [], left)
                continue
            except ConnectionError:
                continue  # nobody listened to an earlier packet
            looked_at += 1
            if (packet := self._sound(data, sender)) is not None:
                self.sender = sender
                if wanted(packet):
                    return packet
        return None

    def _sound(self, data: bytes, sender: Address) -> Packet | None:
        form = self._incoming.get(data[5]) if len(data) > 5 else None
        if form is not None and len(data) == form.nbytes:
            if not sealed(data, self._key):
                self.quality["forged"] += 1
                return None
            if data[:7] == form.tobytes()[:7]:  # magic, version, kind, joints
                packet: Packet = np.frombuffer(data, form.dtype).reshape(())
                if not self.session or (packet["session"] == self.session and sender == self.peer):
                    return packet
        self.quality["foreign"] += 1
        return None
