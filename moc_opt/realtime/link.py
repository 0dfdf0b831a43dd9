"""One end of the wire: a UDP socket that lets only sound packets through, and counts the others."""

from __future__ import annotations

import select
import socket
from dataclasses import dataclass, fields
from time import monotonic, monotonic_ns

from moc_opt.errors import describe
from moc_opt.realtime.key import Address, WireError, written
from moc_opt.realtime.packets import COUNTERS, MAGIC, VERSION, Kind, Packet, layout, sealed

BACKLOG = 256
"""Packets that are looked through at once: a flood of them does not stop the clock."""
_MEMORY = 64
"""Sequence numbers that are remembered."""


@dataclass
class Quality:
    """Counts of packets since the start, received and missing."""

    received: int = 0
    """packets that were taken"""
    missed: int = 0
    """plant: ticks without a command in time; controller: measurements that had not come when a newer one did"""
    late: int = 0
    """commands whose tick was over"""
    doubled: int = 0
    """packets that had come before"""
    reordered: int = 0
    """packets that came after a newer one"""
    truncated: int = 0
    """datagrams of another size than their kind has for this arm"""
    forged: int = 0
    """packets whose check is not that of the key"""
    foreign: int = 0
    """of another session, version, direction or sender, or from a tick that has not come; commands that no safety
    filter gives"""

    def __post_init__(self) -> None:
        assert tuple(field.name for field in fields(self)) == COUNTERS

    def count(self, name: str) -> None:
        """Add one to a count."""
        setattr(self, name, getattr(self, name) + 1)

    def values(self) -> list[int]:
        """Return the counts in the order of the packet."""
        return [getattr(self, name) for name in COUNTERS]

    def __str__(self) -> str:
        return ", ".join(f"{name} {getattr(self, name)}" for name in COUNTERS)


class Sequence:
    """Tells new sequence numbers from those that came before or come too late."""

    def __init__(self) -> None:
        self.newest, self._seen = -1, 0  # bit i: newest - i has come

    def judge(self, number: int) -> str:
        """Return "new", "doubled", "reordered", or "old" if it is too far back to be in the memory."""
        back = self.newest - number
        if back < 0:
            return "new"
        if back >= _MEMORY:
            return "old"
        return "doubled" if self._seen >> back & 1 else "reordered"

    def take(self, number: int) -> None:
        """Remember that a number came."""
        ahead = number - self.newest
        if ahead > 0:
            self._seen = (self._seen << min(ahead, _MEMORY) | 1) & ((1 << _MEMORY) - 1)
            self.newest = number
        elif -ahead < _MEMORY:
            self._seen |= 1 << -ahead


class Link:
    """A socket, a key, and the packets that are expected.

    Args:
        key: of the check.
        expected: kinds that this end receives.
        listen: where; None: wherever the system likes.
        peer: whom to send to; None: not known yet.

    Raises:
        WireError: the address cannot be taken.
    """

    def __init__(
        self, n: int, key: bytes, expected: tuple[Kind, ...], listen: Address | None = None, peer: Address | None = None
    ) -> None:
        self.n, self.peer, self.session = n, peer, 0
        self.quality, self.sender = Quality(), peer
        self._key = key
        self._incoming = {int(kind): Packet(kind, n) for kind in expected}
        self._sizes = {int(kind): layout(kind, n).itemsize for kind in Kind}
        self._scratch = bytearray(4096)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if listen is not None:
                self._socket.bind(listen)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise WireError(
                f"the address {written(listen)} cannot be taken: {error.strerror}; give another one"
            ) from error

    @property
    def address(self) -> Address:
        """Where this end listens."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def send(self, packet: Packet, to: Address | None = None) -> None:
        """Seal a packet and send it; one that the system does not take is lost, as any packet may be."""
        packet["sent_ns"] = monotonic_ns()
        data = packet.seal(self._key)
        try:
            self._socket.sendto(data, self.peer if to is None else to)  # type: ignore[arg-type]
        except OSError as error:
            if not isinstance(error, BlockingIOError | ConnectionError):
                raise WireError(f"nothing can be sent to {written(to or self.peer)}: {describe(error)}") from error

    def receive(self, until: float) -> Packet | None:
        """Return the next sound packet, or None where none has come at the time ``until`` (of ``time.monotonic``) [s].

        It is valid until the next call. ``sender`` is where it came from. What has arrived already is returned even
        where ``until`` has passed.
        """
        unsound = 0
        while unsound < BACKLOG or monotonic() < until:
            try:
                size, sender = self._socket.recvfrom_into(self._scratch)
            except BlockingIOError:
                left = until - monotonic()
                if left <= 0.0:
                    return None
                select.select([self._socket], [], [], left)
                continue
            except ConnectionError:
                continue  # nobody listened where this end sent to: that packet is lost
            found = self._sound(size)
            if found is not None and self.session and (found["session"] != self.session or sender != self.peer):
                self.quality.count("foreign")
                found = None
            if found is not None:
                self.sender = sender
                return found
            unsound += 1
        return None

    def _sound(self, size: int) -> Packet | None:
        data = memoryview(self._scratch)[:size]
        kind = data[5] if size > 5 else 0
        if size != self._sizes.get(kind, -1):
            self.quality.count("truncated")
            return None
        if not sealed(data, self._key):
            self.quality.count("forged")
            return None
        packet = self._incoming.get(kind)
        if packet is None or bytes(data[:4]) != MAGIC or data[4] != VERSION or data[6] != self.n:
            self.quality.count("foreign")
            return None
        packet.buffer[:] = data
        return packet
