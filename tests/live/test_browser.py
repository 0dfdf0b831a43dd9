"""The live page: where it listens, how it ends, and, in a real browser, that its controls reach the run.

Skipped where viser, playwright or a Chromium is missing.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

from moc_opt.live import LiveError
from moc_opt.live.history import QUANTITIES
from moc_opt.live.orders import DCAC
from moc_opt.live.page import LivePage
from moc_opt.scenario import Scenario

pytest.importorskip("viser", reason="the live page needs viser: pip install 'moc-opt[live]'")

SCENARIO = Scenario(start={"swivel": 0.2})
PATIENCE_S = 30.0
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def live() -> Iterator[LivePage]:
    """A page that is kept up to date, at leisure: a browser that draws in software has enough to do."""
    with pytest.MonkeyPatch.context() as patch, LivePage(SCENARIO, port=0) as page:
        patch.setattr("moc_opt.live.page.FRAME_S", 0.3)
        thread = threading.Thread(target=page.wait)
        thread.start()
        yield page
        page.stop()
        thread.join()


def until(true: Any, what: str) -> None:
    """Wait until something holds."""
    end = monotonic() + PATIENCE_S
    while not true():
        assert monotonic() < end, what
        sleep(0.05)


def listening(port: int) -> set[str]:
    """Addresses at which this machine listens on a port, as the kernel writes them."""
    found = set()
    for table in ("tcp", "tcp6"):
        file = Path("/proc/net") / table
        if not file.exists():
            pytest.skip(f"{file}: there is none here")
        for line in file.read_text().splitlines()[1:]:
            _, local, _, state = line.split()[:4]
            address, _, number = local.partition(":")
            if state == "0A" and int(number, 16) == port:
                found.add(address)
    return found


# --- without a browser ---


def test_it_listens_on_loopback_alone(live: LivePage) -> None:
    assert live.url.startswith("http://127.0.0.1:")
    assert listening(live.server.get_port()) == {"0100007F"}


def test_it_cannot_be_made_public_from_the_page(live: LivePage) -> None:
    assert live.server.request_share_url() is None
    assert live.server._share_tunnel is None


@pytest.mark.parametrize("wrong", [{"host": "0.0.0.0"}, {"port": 70000}, {"port": -1}])
def test_what_is_refused_opens_nothing(wrong: dict[str, Any]) -> None:
    with pytest.raises(LiveError):
        LivePage(SCENARIO, **wrong)


def test_it_keeps_step_with_the_clock(live: LivePage) -> None:
    until(lambda: live.run.moment().t_s > 0.5, "it does not begin")

    def in_step() -> bool:
        start, simulated = monotonic(), live.run.moment().t_s
        sleep(1.0)
        passed = monotonic() - start
        return live.run.moment().t_s - simulated == pytest.approx(passed, rel=0.25)

    until(in_step, "too fast, or too slow, whenever one looks")


@pytest.mark.parametrize(
    ("field", "wrong"), [("regularization", "-1"), ("regularization", "a lot"), ("K_N", ""), ("K_X", "nan")]
)
def test_a_wrong_number_changes_nothing(live: LivePage, field: str, wrong: str) -> None:
    panel, before = live._panel, live.run.control
    panel._fields[field].value = wrong
    panel._do(panel._apply)
    assert panel._fields[field].value == panel._written(field) != wrong
    assert live.run.control == before


def test_an_error_in_the_loop_ends_the_page_and_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    with LivePage(SCENARIO, port=0) as page:

        def broken(ticks: int) -> None:
            raise ZeroDivisionError("seeded")

        monkeypatch.setattr(page.run, "advance", broken)
        with pytest.raises(ZeroDivisionError, match="seeded"):
            page.wait(PATIENCE_S)


def test_ctrl_c_ends_it_cleanly() -> None:
    code = (
        "from moc_opt.live.page import serve; from moc_opt.scenario import Scenario; "
        "raise SystemExit(serve(Scenario(), port=0))"
    )
    program = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert program.stderr is not None
    try:
        assert "live at http://127.0.0.1:" in program.stderr.readline()
        sleep(0.5)
        program.send_signal(signal.SIGINT)
        out, err = program.communicate(timeout=PATIENCE_S)
    finally:
        program.kill()
    assert (program.returncode, out, err) == (0, "", "ended\n")


# --- in a browser ---


@pytest.fixture(scope="module")
def page(chromium: Any, live: LivePage) -> Iterator[Any]:
    """The open page; in the end there must have been no error, and no request to anyone else."""
    opened = chromium.new_page(viewport={"width": 480, "height": 320})
    trouble: list[str] = []
    requests: list[str] = []
    opened.on("console", lambda message: trouble.append(message.text) if message.type == "error" else None)
    opened.on("pageerror", lambda error: trouble.append(str(error)))
    opened.on("request", lambda request: requests.append(request.url))
    opened.goto(live.url)
    opened.wait_for_selector("text=real time", timeout=60_000)
    yield opened
    opened.close()
    assert trouble == []
    assert [
        url for url in requests if not url.removeprefix("blob:").startswith(live.address) and url[:5] != "data:"
    ] == []


def click(locator: Any) -> None:
    """Without waiting for the layout to rest: software draws one or two pictures of the arm a second."""
    locator.evaluate("element => element.click()")


def enter(field: Any, text: str) -> None:
    field.evaluate("element => element.focus()")
    field.fill(text)
    field.evaluate("element => element.blur()")


def choose(page: Any, live: LivePage, solver: str) -> None:
    click(page.get_by_label("Solver"))
    click(page.get_by_role("option", name=solver, exact=True))
    until(lambda: live.run.moment().solver == solver, "the choice does not reach the run")


def pictures(page: Any) -> list[str]:
    """The four plots."""
    found: list[str] = page.evaluate(
        "[...document.querySelectorAll('.uplot canvas')].map(c => c.toDataURL())"
    )
    return found


def test_a_solver_is_switched_and_the_plots_react(page: Any, live: LivePage) -> None:
    before = pictures(page)
    assert len(before) == 4
    assert page.evaluate("document.body.innerText").count("exact ·") == 1
    choose(page, live, DCAC)
    page.wait_for_function(f"document.body.innerText.includes('{DCAC} ·')", polling=100, timeout=60_000)
    solving = QUANTITIES.index("solve_us")
    until(lambda: np.isnan(live.run.history(10**6)[-20:, solving]).all(), "DCAC solves nothing")
    assert all(old != new for old, new in zip(before, pictures(page), strict=True))


def test_bad_input_gives_a_message_and_the_run_goes_on(page: Any, live: LivePage) -> None:
    field = page.locator("xpath=//label[starts-with(., 'K_X')]/following::input[1]")
    apply = page.get_by_role("button", name="Apply")
    typed = live._panel._fields["K_X"]
    good = typed.value
    enter(field, "-5")
    click(apply)
    page.wait_for_function("document.body.innerText.includes('greater than 0')", polling=100, timeout=60_000)
    until(lambda: typed.value == good, "the field goes back to what holds")
    t = live.run.moment().t_s
    until(lambda: live.run.moment().t_s > t + 0.2, "the run stands still")
    enter(field, "2500")
    click(apply)
    until(lambda: live.run.gains.K_X == 2500.0, "a good one is taken")


def test_the_elbow_is_pushed_and_the_clock_stopped(page: Any, live: LivePage) -> None:
    live.run.choose(DCAC)
    until(lambda: live.run.moment().solver == DCAC, "DCAC, which leaves the elbow where it is pushed")
    q = live.run.moment().q
    click(page.get_by_role("button", name="+", exact=True))
    until(lambda: np.abs(live.run.moment().q - q).max() > 0.01, "nothing moves")
    click(page.get_by_label("Pause"))
    until(lambda: live._panel.paused, "the box does not reach the run")

    def stands_still() -> bool:
        t = live.run.moment().t_s
        sleep(0.3)
        return live.run.moment().t_s == t

    until(stands_still, "it goes on")
    stopped = live.run.moment().t_s
    click(page.get_by_label("Pause"))
    until(lambda: live.run.moment().t_s > stopped, "it does not go on")
