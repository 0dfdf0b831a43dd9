"""The live page and its access token."""

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

from moc_opt.live.page import LivePage
from moc_opt.live.run import DCAC, QUANTITIES, solver_of
from moc_opt.scenario import Scenario
from tests.conftest import opened

viser = pytest.importorskip("viser", reason="the live page needs viser: pip install '.[live]'")

import msgspec  # noqa: E402
from viser._messages import GuiUpdateMessage  # noqa: E402
from websockets.exceptions import ConnectionClosed  # noqa: E402
from websockets.sync.client import connect  # noqa: E402


@pytest.fixture(scope="module")
def live() -> Iterator[LivePage]:
    """Serve a page with slow updates, because software rendering is slow."""
    with pytest.MonkeyPatch.context() as patch, LivePage(Scenario(start={"swivel": 0.2}), port=0) as page:
        patch.setattr("moc_opt.live.page.FRAME_S", 0.3)
        thread = threading.Thread(target=page.wait)
        thread.start()
        yield page
        page.stop()
        thread.join()


def until(true: Any, what: str) -> None:
    end = monotonic() + 30.0
    while not true():
        assert monotonic() < end, what
        sleep(0.05)


def test_page_listens_only_on_127_0_0_1(live: LivePage) -> None:
    with socket.create_connection(("127.0.0.1", live.server.get_port())):
        pass
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", live.server.get_port()))


def test_run_advances_in_real_time(live: LivePage) -> None:
    until(lambda: live.run.t_s > 0.5, "the run does not begin")

    def in_step() -> bool:
        lead = live.run.t_s - monotonic()
        sleep(1.0)
        return abs(live.run.t_s - monotonic() - lead) < 0.25

    until(in_step, "the run is always too fast or too slow")


def test_last_chosen_solver_runs_after_quick_changes(live: LivePage) -> None:
    for name in ("rnn", "exact", "rnn", "osqp"):
        live._panel._solver.value = name
    until(lambda: solver_of(live.run.used) == "osqp", "another solver runs")
    assert live._panel._solver.value == live.run.solver == "osqp"


def knock(live: LivePage, path: str, say: bytes = b"") -> Any:
    """Open a WebSocket as another site's page would, and return the first answer."""
    uri, protocol = f"ws://127.0.0.1:{live.server.get_port()}{path}", f"viser-v{viser.__version__}"
    with (
        suppress(ConnectionClosed),
        connect(uri, origin="http://evil.example", subprotocols=[protocol]) as link,  # type: ignore[arg-type, list-item]
    ):
        if say:
            link.send(say)
            sleep(0.5)
        return link.recv(timeout=10.0)
    return None


@pytest.mark.parametrize("path", ["/", "/?token={token}", "/{token}x", "//{token}", "/%ff"])
def test_client_without_the_token_receives_nothing(live: LivePage, path: str) -> None:
    assert knock(live, path.format(token=live.url.rpartition("/")[2])) is None


def test_message_without_the_token_is_ignored(live: LivePage) -> None:
    box: Any = live._panel._solver
    order = msgspec.msgpack.encode(GuiUpdateMessage(box._impl.uuid, {"value": "rnn"}).as_serializable_dict())

    async def slow(client: object) -> None:
        await asyncio.sleep(0.3)

    hooks = live.server._websock_server._client_connect_cb
    hooks.insert(0, slow)
    assert knock(live, "/", order) is None
    hooks.remove(slow)
    sleep(0.5)
    assert box.value != "rnn"
    assert knock(live, f"/{live.url.rpartition('/')[2]}", order)
    until(lambda: box.value == "rnn", "the message is not obeyed")
    box.value = live.run.solver


@pytest.fixture(scope="module")
def page(chromium: Any, live: LivePage) -> Iterator[Any]:
    own, few = live.url.partition("/?")[0], {"viewport": {"width": 300, "height": 200}, "device_scale_factor": 0.25}
    # Draw twice a second, because software rendering is slow.
    slow = "window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 500)"
    with opened(chromium, live.url, "text=real time", own, ("error",), slow, **few) as found:
        yield found


def click(locator: Any) -> None:
    """Click without waiting for the layout to settle."""
    locator.evaluate("element => element.click()")


def enter(field: Any, text: str) -> None:
    field.evaluate("element => element.focus()")
    field.fill(text)
    field.evaluate("element => element.blur()")


def says(page: Any, text: str) -> None:
    page.wait_for_function(f"document.body.innerText.includes('{text}')", polling=100, timeout=60_000)


def test_plots_change_with_the_solver(page: Any, live: LivePage) -> None:
    pictures = "[...document.querySelectorAll('.uplot canvas')].map(c => c.toDataURL())"
    live._panel._solver.value = "exact"
    says(page, "exact ·")
    before = page.evaluate(pictures)
    assert len(before) == 4
    click(page.get_by_label("Solver"))
    click(page.locator("[role=option]", has_text=DCAC))  # also works before the option is drawn
    says(page, f"{DCAC} ·")
    solving = QUANTITIES.index("solve_us")
    until(lambda: np.isnan(live.run.history(10**6)[-20:, solving]).all(), "DCAC has solve times")
    assert all(old != new for old, new in zip(before, page.evaluate(pictures), strict=True))


def test_run_goes_on_after_bad_input(page: Any, live: LivePage) -> None:
    field = page.locator("xpath=//label[starts-with(., 'K_X')]/following::input[1]")
    apply, typed, before = page.get_by_role("button", name="Apply"), live._panel._fields["K_X"], live.run.control
    good = typed.value
    for wrong, message in (("-5", "greater than 0"), ("a lot", "give a number")):
        enter(field, wrong)
        click(apply)
        says(page, message)
        until(lambda: typed.value == good, "the field does not show the value in use")
        assert live.run.control == before
    t = live.run.t_s
    until(lambda: live.run.t_s > t + 0.2, "the run stands still")
    enter(field, "2500")
    click(apply)
    until(lambda: live.run.control.K_X == 2500.0, "the valid value is not applied")
