"""Where the live page may listen: on this machine alone, unless someone says that more is meant."""

from __future__ import annotations

import socket
from ipaddress import ip_address

from moc_opt.live.orders import LiveError

CONSENT = "--i-know-this-is-public"


def checked_address(host: str, *, public: bool = False) -> str:
    """Return the numeric address that `host` stands for.

    Whoever reaches the page and holds its token commands the simulation; nothing is encrypted.

    Args:
        host: name or address.
        public: the user knows that others can reach it.

    Raises:
        LiveError: there is no such host, or it is not a loopback address and `public` is false.
    """
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as error:
        raise LiveError(f"--host {host!r}: no such host ({error}); leave it out for this machine alone") from error
    addresses = [str(entry[4][0]).partition("%")[0] for entry in found]
    open_ones = [address for address in addresses if not ip_address(address).is_loopback]
    if open_ones and not public:
        raise LiveError(
            f"--host {host!r} means {', '.join(open_ones)}, which other machines can reach; the "
            f"page is not encrypted: leave --host out, or add {CONSENT}"
        )
    return addresses[0]
