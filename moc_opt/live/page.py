"""The live page: a loop in a thread of its own, in step with the clock, and viser to show and command it."""

from __future__ import annotations

import io
import signal
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from threading import Event
from time import monotonic
from typing import Any

from moc_opt.live.access import Access, check_refused, guarded_servers, own_names
from moc_opt.live.address import checked_address
from moc_opt.live.orders import LiveError
from moc_opt.live.panel import Panel
from moc_opt.live.run import LiveRun
from moc_opt.live.scene import LiveScene
from moc_opt.scenario import Scenario

PORT = 8642
FRAME_S, MOST_LAG_S, PIECE_S = 0.08, 0.2, 0.02


class LivePage:
    """A run, its clock and its page; a context manager that ends all of it."""

    def __init__(
        self, scenario: Scenario, *, host: str = "127.0.0.1", port: int = PORT, public: bool = False, title: str = ""
    ) -> None:
        """Build the run, open the page, and let the clock go.

        Args:
            host: where to listen; only this machine can reach the default.
            port: the next free one from here on; 0: any.
            public: the user knows that others can reach `host`.
            title: of the page; the scenario's name if empty.

        Raises:
            LiveError: viser is missing, or the host is not this machine alone and `public` is false.
            MocOptError: the scenario is not usable.
        """
        address = checked_address(host, public=public)
        if not 0 <= port < 65536:
            raise LiveError(f"--port {port}: give 0 to 65535")
        make = _viser()
        self.run = LiveRun(scenario)
        self._pace, self._over = 1.0, Event()
        # Its greeting names addresses that are not always those it listens on; `serve` prints the true one.
        shown = f"[{address}]" if ":" in address else address
        access = Access(own_names(host, address))
        with redirect_stdout(io.StringIO()), guarded_servers(access):
            self.server = make(host=address, port=port, label=f"moc_opt: {title or scenario.name}", verbose=False)
        self.address = f"http://{shown}:{self.server.get_port()}"
        self.url = f"{self.address}/?token={access.token}"
        try:
            check_refused(address, self.server.get_port())
        except LiveError:
            self.server.stop()
            raise
        self.server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self._scene, self._panel = LiveScene(self.server, self.run), Panel(self.server, self.run)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="simulation")
        self._clock = self._thread.submit(self._keep_time)

    def __enter__(self) -> LivePage:
        """Itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close."""
        self.close()

    def show(self) -> None:
        """Bring what is shown up to date, once."""
        moment = self.run.moment()
        with self.server.atomic():
            self._scene.update(moment)
            self._panel.update(moment, self._pace)

    def wait(self, seconds: float | None = None) -> None:
        """Keep the page up to date until so much time is over, or for ever."""
        end = None if seconds is None else monotonic() + seconds
        while not self._over.wait(FRAME_S) and (end is None or monotonic() < end):
            if self._clock.done():
                self._clock.result()  # it never ends by itself: this raises what ended it
            self.show()

    def stop(self) -> None:
        """Let `wait` come to an end."""
        self._over.set()

    def close(self) -> None:
        """Stop the clock, then the page."""
        self._over.set()
        self._thread.shutdown()
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def _keep_time(self) -> None:
        """Run the ticks that real time requires; a delay that is too long to catch up with is dropped."""
        run, before, owed = self.run, monotonic(), 0.0
        while not self._over.is_set():
            now = monotonic()
            passed, before = now - before, now
            if self._panel.paused:
                run.advance(0)
                owed = 0.0
                self._over.wait(PIECE_S)
                continue
            owed += passed
            lost = max(0.0, owed - MOST_LAG_S)
            share = min(1.0, passed)
            if passed > 0.0:
                self._pace += share * ((passed - lost) / passed - self._pace)
            owed -= lost
            ticks = int(owed / run.period_s)
            if ticks:
                run.advance(ticks)
                owed -= ticks * run.period_s
            self._over.wait(max(0.0, PIECE_S - (monotonic() - now)))


def _viser() -> Callable[..., Any]:
    """Return a viser server that cannot be shared beyond its address.

    viser's clients may ask for a tunnel that makes the page public through another host, whatever address it
    listens on; that is refused.
    """
    try:
        import viser
    except ImportError as error:
        raise LiveError("the live page needs viser: pip install 'moc-opt[live]'") from error

    return type("Server", (viser.ViserServer,), {"request_share_url": _no_tunnel})


def _no_tunnel(server: object, verbose: bool = True) -> None:
    """Refuse: stands in the place of `ViserServer.request_share_url`."""


def serve(
    scenario: Scenario, *, host: str = "127.0.0.1", port: int = PORT, public: bool = False,
    seconds: float | None = None, title: str = "",
) -> int:  # fmt: skip
    """Open the page and keep it until Ctrl-C; return the exit code.

    Raises:
        MocOptError: as `LivePage`.
    """
    with LivePage(scenario, host=host, port=port, public=public, title=title) as page:
        # No exception from anywhere, which could leave a lock of the page's threads behind; a second Ctrl-C is one.
        def stop(number: int, frame: object) -> None:
            signal.signal(signal.SIGINT, before)
            page.stop()

        before = signal.signal(signal.SIGINT, stop)
        print(f"live at {page.url} - Ctrl-C ends it", file=sys.stderr, flush=True)
        try:
            page.wait(seconds)
        finally:
            signal.signal(signal.SIGINT, before)
    print("ended", file=sys.stderr)
    return 0
