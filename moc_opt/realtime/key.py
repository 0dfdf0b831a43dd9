"""Who may speak on the wire: addresses, and the key of the check on every packet.

Without a key only processes of this machine can take part, and any of them may. With one, only who has it; nothing is
encrypted.
"""

from __future__ import annotations

import os
import socket
from ipaddress import ip_address
from pathlib import Path

from moc_opt.errors import MocOptError
from moc_opt.inputs.files import read_text

VARIABLE = "MOC_OPT_WIRE_KEY"
LOOPBACK_KEY = b"moc_opt: loopback, no secret"
SHORTEST, LONGEST = 16, 32
"""Bytes of a key; BLAKE2s takes no longer ones."""


class WireError(MocOptError, RuntimeError):
    """The wire cannot be set up, or the other end does not answer."""


Address = tuple[str, int]
"""Host and port."""


def written(address: Address | None) -> str:
    """Write an address as `parse_address` reads it."""
    return "nobody" if address is None else f"{address[0]}:{address[1]}"


def parse_address(text: str, option: str) -> Address:
    """Return numeric host and port of "HOST:PORT".

    Raises:
        WireError: it is no such text, or there is no such host.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or len(port) > 5 or int(port) > 65535:
        raise WireError(f"{option} {text!r}: give HOST:PORT, as 127.0.0.1:30200")
    try:
        found = socket.getaddrinfo(host, None, family=socket.AF_INET, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise WireError(f"{option} {text!r}: no such host ({error})") from error
    return str(found[0][4][0]), int(port)


def read_key(file: Path | None) -> bytes | None:
    """Return the key of a file, or else of the environment variable; None where there is neither.

    Raises:
        WireError: the file cannot be read, or holds no key.
    """
    text = os.environ.get(VARIABLE, "") if file is None else read_text(file, "--key-file", WireError)
    if file is None and not text:
        return None
    key = text.strip().encode(errors="surrogateescape")
    where = VARIABLE if file is None else f"--key-file {str(file)!r}"
    if not SHORTEST <= len(key) <= LONGEST or b"\n" in key:
        raise WireError(
            f"{where}: a key of {len(key)} bytes: give one line of {SHORTEST} to {LONGEST}, such as "
            "`openssl rand -hex 16` prints"
        )
    return key


def checked_key(key: bytes | None, host: str, option: str) -> bytes:
    """Return the key; without one, that of the loopback.

    Raises:
        WireError: there is none, and the address can be reached from other machines.
    """
    if key is None and not ip_address(host).is_loopback:
        raise WireError(
            f"{option} {host}: other machines reach that address, and whoever speaks on it moves the arm: give both "
            f"ends the same key by --key-file or {VARIABLE}, or take 127.0.0.1"
        )
    return LOOPBACK_KEY if key is None else key
