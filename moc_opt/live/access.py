"""Who may see and command the live page: the one who was told its address, from a page of this address.

A browser lets any site open a WebSocket to this machine, and a foreign name may be made to point here (DNS rebinding).
So each request must name this page as its host, come from it where it says where it comes from, and carry the token
that the printed address holds; a cookie keeps it for the page's own later requests.
"""

from __future__ import annotations

import hmac
import http.client
import secrets
import socket
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from http.cookies import CookieError, SimpleCookie
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from moc_opt.live.orders import LiveError

if TYPE_CHECKING:
    from websockets.http11 import Request, Response

    Answer = Callable[[Any, Request], Response | None]


def own_names(host: str, address: str) -> set[str]:
    """Return names and addresses under which a page is asked for that listens at ``address``, given as ``host``.

    A loopback address has three; one that stands for all of this machine's has the machine's name, and, as "*", any
    address in numbers: only names can be made to point elsewhere.
    """
    names = {host, address}
    if ip_address(address).is_loopback:
        names |= {"localhost", "127.0.0.1", "::1"}
    if ip_address(address).is_unspecified:
        names |= {socket.gethostname(), socket.getfqdn(), "localhost", "*"}
    return {name.lower() for name in names}


class Access:
    """The rule, with its token.

    Args:
        names: see `own_names`.
        token: None draws one.
    """

    def __init__(self, names: Collection[str], token: str | None = None) -> None:
        self.names = frozenset(names)
        self.token = secrets.token_urlsafe(24) if token is None else token

    def _own(self, address: str, port: int) -> bool:
        """Return whether "host:port" is this page."""
        try:
            parts = urlsplit(f"http://{address}")
            name, asked = parts.hostname or "", parts.port or 80
        except ValueError:
            return False
        if parts.netloc != address or "@" in address or asked != port:
            return False
        return name in self.names or ("*" in self.names and _is_address(name))

    def refusal(self, request: Request, port: int) -> str:
        """Say why this request is refused; "" where it is allowed.

        Args:
            request: of a page, a file or a WebSocket.
            port: that it came to.
        """
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not self._own(hosts[0], port):
            return "this page is not of that host"
        if any(not origin.startswith("http://") or not self._own(origin[7:], port) for origin in origins):
            return "another site asks"
        given = [*parse_qs(urlsplit(request.path).query).get("token", []), *_cookies(request, cookie(port))]
        # As bytes: a token of other characters than ASCII is a wrong one, not an error.
        if not any(hmac.compare_digest(one.encode(errors="replace"), self.token.encode()) for one in given):
            return "open the address that was printed where this page was started; it holds a token"
        return ""

    def around(self, answer: Answer | None) -> Answer:
        """Return ``answer`` behind this rule, as websockets' ``process_request``."""

        def process_request(connection: Any, request: Request) -> Response | None:
            port = connection.local_address[1]
            why = self.refusal(request, port)
            if why:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"refused: {why}\n")  # type: ignore[no-any-return]
            response = None if answer is None else answer(connection, request)
            if response is not None:
                response.headers["Set-Cookie"] = f"{cookie(port)}={self.token}; HttpOnly; SameSite=Strict; Path=/"
                response.headers["Referrer-Policy"] = "no-referrer"  # the address holds the token
            return response

        return process_request


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def cookie(port: int) -> str:
    """Name of the cookie; cookies are shared between the ports of a host."""
    return f"moc_opt_{port}"


def _cookies(request: Request, name: str) -> list[str]:
    found = []
    for line in request.headers.get_all("Cookie"):
        try:
            crumb = SimpleCookie(line).get(name)
        except CookieError:
            continue  # of another page on this machine; without ours the request is refused anyway
        found += [] if crumb is None else [crumb.value]
    return found


@contextmanager
def guarded_servers(access: Access) -> Iterator[None]:
    """Put every WebSocket server that starts meanwhile behind the rule: viser has no place for one.

    The page that is started here has to be checked with `check_refused`: another viser may start its server otherwise.
    """
    import websockets.asyncio.server as server  # late: it comes with viser, which is an extra

    serve = server.serve

    def guarded(*arguments: Any, process_request: Answer | None = None, **options: Any) -> Any:
        return serve(*arguments, process_request=access.around(process_request), **options)  # type: ignore[arg-type]

    server.serve = guarded  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def check_refused(address: str, port: int) -> None:
    """Ask for the page without its token.

    Raises:
        LiveError: it was given out; the page must not stay open.
    """
    here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(address, address)
    asked = http.client.HTTPConnection(here, port, timeout=10.0)
    try:
        asked.request("GET", "/")
        status = asked.getresponse().status
    except OSError as error:
        raise LiveError(f"the live page does not answer at {address}, port {port}: {error}") from error
    finally:
        asked.close()
    if status != http.HTTPStatus.FORBIDDEN:
        raise LiveError("this version of viser serves the page without its token: pip install 'moc-opt[live]'")
