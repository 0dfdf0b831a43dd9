"""Who may open the live page: by host, origin and token, in the rule alone and at a running page."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from time import sleep
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.live.access import Access, cookie, own_names
from moc_opt.live.orders import LiveError
from moc_opt.scenario import Scenario

websockets = pytest.importorskip("websockets", reason="the live page needs viser: pip install 'moc-opt[live]'")
pytest.importorskip("viser", reason="the live page needs viser: pip install 'moc-opt[live]'")

from websockets.datastructures import Headers  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.http11 import Request  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from moc_opt.live import page as live_page  # noqa: E402

PORT, TOKEN = 8642, "the-token"
HERE = f"127.0.0.1:{PORT}"


def asked(path: str = f"/?token={TOKEN}", **headers: str | list[str]) -> Request:
    found = Headers()
    for name, value in {"Host": HERE, **headers}.items():
        for one in [value] if isinstance(value, str) else value:
            found[name] = one
    return Request(path, found)


def refusal(request: Request, host: str = "127.0.0.1", address: str = "127.0.0.1") -> str:
    return Access(own_names(host, address), TOKEN).refusal(request, PORT)


@pytest.mark.parametrize("host", [HERE, f"localhost:{PORT}", f"LocalHost:{PORT}", f"[::1]:{PORT}"])
def test_its_own_names_are_allowed_with_the_token(host: str) -> None:
    assert refusal(asked(Host=host)) == ""
    assert refusal(asked(Host=host, Origin=f"http://{host}")) == ""
    assert refusal(asked("/", Host=host, Cookie=f"a=b; {cookie(PORT)}={TOKEN}")) == ""


@pytest.mark.parametrize(
    "host",
    ["evil.example", f"evil.example:{PORT}", "127.0.0.1", "127.0.0.1:1", "", f"127.0.0.1.evil.example:{PORT}",
     f"me@127.0.0.1:{PORT}", f"127.0.0.1:{PORT}/x", f"192.168.1.7:{PORT}", f"127.0.0.1:{PORT}x", f"[::1:{PORT}"],
)  # fmt: skip
def test_another_host_is_refused_whatever_it_holds(host: str) -> None:
    assert "host" in refusal(asked(Host=host, Cookie=f"{cookie(PORT)}={TOKEN}"))


def test_a_request_with_two_hosts_or_none_is_refused() -> None:
    assert refusal(asked(Host=[HERE, "evil.example"]))
    assert refusal(Request(f"/?token={TOKEN}", Headers()))


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", f"https://{HERE}", "http://127.0.0.1", "http://localhost:1", "file://",
     f"http://{HERE}.evil.example", f"http://{HERE}/x"],
)  # fmt: skip
def test_another_origin_is_refused_whatever_it_holds(origin: str) -> None:
    assert "site" in refusal(asked(Origin=origin))
    assert "site" in refusal(asked(Origin=[f"http://{HERE}", origin]))


@given(token=st.text(max_size=40))
def test_no_other_token_opens(token: str) -> None:
    allowed = token == TOKEN
    assert (refusal(asked(f"/?token={token}")) == "") == allowed or "&" in token or "#" in token or "%" in token
    assert refusal(asked(f"/?other={TOKEN}"))
    assert refusal(asked("/", Cookie=f"{cookie(PORT + 1)}={TOKEN}"))


def test_a_token_of_bytes_that_are_no_text_is_a_wrong_one() -> None:
    """A server hands them on as lone surrogates."""
    assert "token" in refusal(asked("/?token=\udcff%ff%00"))


def test_a_public_page_is_asked_for_by_its_numbers_or_its_own_name() -> None:
    assert refusal(asked(Host=f"10.1.2.3:{PORT}"), "0.0.0.0", "0.0.0.0") == ""
    assert refusal(asked(Host=f"evil.example:{PORT}"), "0.0.0.0", "0.0.0.0")
    assert refusal(asked(Host=f"robot.lab:{PORT}"), "robot.lab", "10.1.2.3") == ""
    assert refusal(asked(Host=f"10.1.2.4:{PORT}"), "robot.lab", "10.1.2.3")


# --- a running page ---


@pytest.fixture(scope="module")
def live() -> Iterator[live_page.LivePage]:
    with live_page.LivePage(Scenario(), port=0) as page:
        yield page


def status(live: live_page.LivePage, path: str, headers: dict[str, str] | None = None) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", live.server.get_port(), timeout=10.0)
    connection.request("GET", path, headers=headers or {})
    answer = connection.getresponse()
    connection.close()
    return answer.status, answer.headers.get("Set-Cookie", "")


def test_the_page_is_given_out_with_its_token_and_not_without(live: live_page.LivePage) -> None:
    token = live.url.partition("token=")[2]
    assert status(live, "/")[0] == 403
    assert status(live, "/index.html?token=wrong")[0] == 403
    found, kept = status(live, f"/?token={token}")
    assert found == 200
    assert "HttpOnly" in kept
    assert "SameSite=Strict" in kept
    assert status(live, "/", {"Cookie": kept.partition(";")[0]})[0] == 200
    assert status(live, f"/?token={token}", {"Host": "evil.example"})[0] == 403


@pytest.mark.parametrize(
    ("with_token", "headers"),
    [(False, {}), (True, {"Origin": "http://evil.example"}), (False, {"Origin": "own"})],
    ids=["no token", "another site", "no token from here"],
)
def test_a_websocket_is_refused_like_the_page(
    live: live_page.LivePage, with_token: bool, headers: dict[str, str]
) -> None:
    url = (live.url if with_token else live.address).replace("http", "ws")
    origin: Any = headers.get("Origin")
    origin = live.address if origin == "own" else origin
    with pytest.raises(InvalidStatus) as refused, connect(url, origin=origin):
        pass
    assert refused.value.response.status_code == 403


def test_a_websocket_with_the_token_is_let_in(live: live_page.LivePage) -> None:
    import viser

    protocol: Any = f"viser-v{viser.__version__}"
    with connect(live.url.replace("http", "ws"), origin=live.address, subprotocols=[protocol]) as opened:  # type: ignore[arg-type]
        assert opened.recv(timeout=10.0)


def test_a_page_that_cannot_be_protected_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Should viser start its server otherwise, nothing is served without a token: the page is not opened at all."""
    monkeypatch.setattr(Access, "around", lambda self, answer: answer)
    with pytest.raises(LiveError, match="without its token"):
        live_page.LivePage(Scenario(), port=0)


def test_of_rapid_choices_the_one_that_the_list_shows_runs(
    live: live_page.LivePage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page calls back from many threads: the first choice must not come through after the second."""
    panel: Any = live._panel
    begun, choose = Event(), live.run.choose

    def slowly(name: str) -> None:
        if name == "rnn":
            begun.set()
            sleep(0.3)
        choose(name)

    monkeypatch.setattr(live.run, "choose", slowly)
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(setattr, panel._solver, "value", "rnn")
        assert begun.wait(10.0)
        second = threads.submit(setattr, panel._solver, "value", "osqp")
        first.result(), second.result()
    assert live.run.solver == panel._solver.value == "osqp"
