"""One end of the wire: its settings, its address and key, and a UDP socket that lets only sound packets through.

Without a key only processes of this machine can take part, and any of them may. With one, only who has it; nothing is
encrypted.
"""

from __future__ import annotations

import os
import select
import socket
from collections.abc import Callable
from ipaddress import ip_address
from pathlib import Path
from time import monotonic
from typing import ClassVar

import numpy as np
from pydantic import Field

from moc_opt.errors import MocOptError, describe
from moc_opt.inputs.files import read_text
from moc_opt.inputs.settings import Settings
from moc_opt.realtime.packets import COUNTERS, LOOPBACK_KEY, Kind, Packet, make_packet, seal, sealed

VARIABLE = "MOC_OPT_WIRE_KEY"
SHORTEST, LONGEST = 16, 32  #: Bytes of a key; BLAKE2s takes no longer ones.
BACKLOG = 256  #: Packets that are looked through at once: a flood of them does not stop the clock.

Address = tuple[str, int]  #: Host and port.


class WireError(MocOptError, RuntimeError):
    """The wire cannot be set up, or the other end does not answer."""


class WireSettings(Settings):
    """The plant's watchdog, and time-outs."""

    KIND: ClassVar[str] = "[wire]"
    ERROR: ClassVar[type[MocOptError]] = WireError

    hold_ticks: int = Field(5, ge=0, description="ticks in a row without a command for which the last torque is held")
    damp_ticks: int = Field(
        50, ge=0, description="ticks after those, with gravity compensation and damping, before the brakes close"
    )
    damping_Nm_s_per_rad: float = Field(5.0, gt=0.0, le=1e3, description="damping of every joint in those ticks")
    wait_s: float = Field(60.0, gt=0.0, description="time for which either end waits for the other one to start")
    silence_s: float = Field(5.0, gt=0.0, description="time without a measurement after which the controller gives up")
    resend_s: float = Field(0.2, gt=0.0, description="lock-step: time after which a measurement is sent again")
    resends: int = Field(
        20, ge=0, description="lock-step: number of times a measurement is sent again; then the tick counts as missed"
    )


def written(address: Address | None) -> str:
    """Write an address as `parse_address` reads it."""
    return "nobody" if address is None else f"{address[0]}:{address[1]}"


def parse_address(text: str, option: str) -> Address:
    """Return numeric host and port of "HOST:PORT"; a WireError where it is no such text, or there is no such host."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise WireError(f"{option} {text!r}: give HOST:PORT, as 127.0.0.1:30200")
    try:
        found = socket.getaddrinfo(host, None, family=socket.AF_INET, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise WireError(f"{option} {text!r}: no such host ({error})") from error
    return str(found[0][4][0]), int(port)


def read_key(file: Path | None, host: str, option: str) -> bytes:
    """Return the key of a file, or else of the environment variable, or else that of the loopback.

    Raises:
        WireError: it has a wrong length, or there is none and other machines reach the host.
    """
    text = os.environ.get(VARIABLE, "") if file is None else read_text(file, "--key-file", WireError)
    if file is None and not text:
        if ip_address(host).is_loopback:
            return LOOPBACK_KEY
        raise WireError(
            f"{option} {host}: other machines reach that address, and whoever speaks on it moves the arm: give both "
            f"ends the same key by --key-file or {VARIABLE}, or take 127.0.0.1"
        )
    key = text.strip().encode(errors="surrogateescape")
    if not SHORTEST <= len(key) <= LONGEST:
        raise WireError(
            f"{VARIABLE if file is None else f'--key-file {str(file)!r}'}: a key of {len(key)} bytes: give one line of "
            f"{SHORTEST} to {LONGEST}, such as `openssl rand -hex 16` prints"
        )
    return key


class Link:
    """A socket, a key, and the kinds of packet that this end receives; a WireError where the address cannot be taken.

    Attributes:
        peer: whom to send to; None: not known yet.
        session: 0 until it is known.
        quality: a count for each of ``packets.COUNTERS``.
        sender: of the last packet.
    """

    def __init__(
        self, n: int, key: bytes, expected: tuple[Kind, ...], listen: Address | None = None, peer: Address | None = None
    ) -> None:
        self.n, self.peer, self.session = n, peer, 0
        self.quality, self.sender = dict.fromkeys(COUNTERS, 0), peer
        self._key, self._incoming = key, {int(kind): make_packet(kind, n) for kind in expected}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if listen is not None:
                self._socket.bind(listen)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise WireError(f"the address {written(listen)} cannot be taken: {error.strerror}; give another") from error

    @property
    def address(self) -> Address:
        """Where this end listens."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    @property
    def heard(self) -> str:
        """What has come so far, in words."""
        return ", ".join(f"{name} {count}" for name, count in self.quality.items() if count) or "nothing came"

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def send(self, packet: Packet, to: Address | None = None) -> None:
        """Seal a packet and send it; one that the system does not take is lost, as any packet may be."""
        try:
            self._socket.sendto(seal(packet, self._key), to or self.peer)  # type: ignore[arg-type]
        except (BlockingIOError, ConnectionError):
            pass
        except OSError as error:
            raise WireError(f"nothing can be sent to {written(to or self.peer)}: {describe(error)}") from error

    def receive(self, until: float, wanted: Callable[[Packet], bool] = lambda packet: True) -> Packet | None:
        """Return the next sound packet that is wanted, or None at ``until`` (of ``time.monotonic``) [s].

        What has arrived already is looked at even where ``until`` has passed.
        """
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
                continue  # nobody listened where this end sent to: that packet is lost
            looked_at += 1
            if (packet := self._sound(data, sender)) is not None:
                self.sender = sender
                if wanted(packet):
                    return packet
        return None

    def _sound(self, data: bytes, sender: Address) -> Packet | None:
        """Return a packet of this run, or count what is wrong with it."""
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
