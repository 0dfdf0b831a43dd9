"""Pages: one file that asks for nothing, holds what was given, and is written all or nothing."""

from __future__ import annotations

import base64
import gzip
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urljoin

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given

from moc_opt import figures
from moc_opt.errors import BrowserError, ReportError, UnknownNameError
from moc_opt.report import document
from moc_opt.report.export import save_figures
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from tests.odd_inputs import names


class Resources(HTMLParser):
    """Whatever a browser might fetch, all element names, ids and inline scripts."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.data: dict[str, str] = {}
        self._inside: str | None = None
        self.styles = ""
        self.text = ""
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        known = dict(attrs)
        for name in ("src", "href", "srcset", "data", "poster", "action", "background", "xlink:href"):
            if known.get(name) and not (tag == "a" and name == "href"):
                self.fetched.append(str(known[name]))
        if tag == "a":
            self.links.append(str(known["href"]))
        self.styles += known.get("style") or ""
        if "id" in known:
            self.ids.append(str(known["id"]))
        self._inside = str(known.get("id", tag)) if tag in ("script", "style") else None

    def handle_endtag(self, tag: str) -> None:
        self._inside = None

    def handle_data(self, data: str) -> None:
        if self._inside == "style":
            self.styles += data
        elif self._inside:
            self.data[self._inside] = data
        else:
            self.text += data


@pytest.fixture(scope="module")
def full() -> Page:
    """A page with one of everything, and texts that would like to be markup."""
    rng = np.random.default_rng(1)
    made = Page("Title <b>", "Subtitle <b>")
    made.headline("Headline <b>")
    made.section("Results")
    made.text("First <b>\n\nSecond `name`.")
    made.link("replay.html#t=3", "Link <b>", "after it <b>")
    made.table(Table("Times", [Column("n", "solver"), Column("t", "time", "us")], [{"n": "<b>", "t": 1.5}]))
    made.figure(figures.latency_ecdf({"<b>": rng.lognormal(size=100)}, 9.0), "Times of <b>", name="ecdf")
    made.figure(
        figures.box_plots({"<b>": {"<b>": rng.random(9)}}, "error [mm]"), "The same words twice over again"
    )
    made.section("Results")
    made.figure(figures.latency_ecdf({"a": [1.0]}), "The same words twice over indeed")
    made.environment(
        {"seed": 3, "machine": {"cpu": "<b>", "cores": [1, 2], "none": None, "deep": {"er": True}}}
    )
    return made


def test_nothing_is_fetched(full: Page) -> None:
    found = Resources(full.html())
    assert [address for address in found.fetched if not address.startswith("data:")] == []
    assert "@import" not in found.styles
    assert "url(" not in found.styles
    scripts = "".join(found.data.values())
    assert not re.search(r"\b(fetch|XMLHttpRequest|import|WebSocket|sendBeacon)\s*\(", scripts)
    assert "link" in found.tags, "an icon of its own, or the browser asks for one"


def tags_and_attributes(text: str) -> list[tuple[str, ...]]:
    """Of a page on which everything is called that."""
    made, found = Page(text, text), []
    made.headline(text)
    made.section(text)
    made.table(Table(text, [Column("name", text, help=text)], [{"name": text}]))
    made.environment({"solver": text, "deeper": {text: text}})
    parser = HTMLParser()
    parser.handle_starttag = lambda tag, attrs: found.append((tag, *(key for key, _ in attrs)))  # type: ignore[method-assign]
    parser.feed(made.html())
    return found


@given(names)
def test_no_name_makes_a_tag_an_attribute_or_a_script(text: str) -> None:
    plain = [tags_and_attributes(each) for each in ("a", "", "a `b`\n\nc", "long " * 20, "1.5")]
    found = tags_and_attributes(text)
    assert set(found) <= {tag for page in plain for tag in page}
    assert sum(tag == "script" for tag, *_ in found) == sum(tag == "script" for tag, *_ in plain[0])


def test_data_come_back(full: Page) -> None:
    found = Resources(full.html())
    for name, figure in full.figures.items():
        assert json.loads(found.data[f"{name}-data"]) == json.loads(figure.to_json())
    unpacked = gzip.decompress(base64.b64decode(found.data["plotly-packed"])).decode()
    assert "plotly.js v" in unpacked[:200]


def test_save_is_reproducible_and_small(full: Page, tmp_path: Path) -> None:
    first, second = full.save(tmp_path / "a" / "report.html"), full.save(tmp_path / "b.html")
    assert first.read_bytes() == second.read_bytes()
    assert first.stat().st_size < 3_000_000
    assert [file.name for file in first.parent.iterdir()] == ["report.html"]


def test_a_page_that_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = Page("Large")
    made.figure(go.Figure(go.Scatter(y=np.random.default_rng(0).random(2000))), "Noise.", name="noise")
    old = made.save(tmp_path / "report.html").read_bytes()
    monkeypatch.setattr(document, "MAX_BYTES", 100_000)
    with pytest.raises(ReportError, match=r"noise \(0\.0 MB\)"):
        made.save(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_bytes() == old


@pytest.mark.parametrize("target", ["replay.html", "a b (1).html", "größe.html#t=3.2"])
def test_a_link_leads_to_a_file_beside_the_page(target: str) -> None:
    made = Page("Linked")
    made.link(target, "text", " and so on")
    (address,) = Resources(made.html()).links
    assert unquote(urljoin("file:///folder/report.html", address)) == f"file:///folder/{target}"


@pytest.mark.parametrize(
    "target",
    [
        "", "https://example.org/x.html", "//example.org/x.html", "/etc/x.html", "javascript:alert(1)", "../up.html",
        "a/../../up.html", "\\\\example.org\\x", "%2e%2e/x.html", '"><img>',
    ],
)  # fmt: skip
def test_no_link_leads_anywhere_else(target: str) -> None:
    with pytest.raises(ReportError):
        Page("Linked").link(target, "text")


def test_what_cannot_be_written_is_said(full: Page, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ReportError, match="cannot be written"):
        full.save(tmp_path / "file" / "report.html")
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(ReportError, match="cannot be written"):
        full.save(tmp_path / "folder.html")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder.html"]


def test_figures_without_playwright_or_of_another_format_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = {"one": figures.box_plots({"a": {"t": [1.0]}}, "y")}
    with pytest.raises(UnknownNameError, match="pdf, svg"):
        save_figures(made, tmp_path, ["png"])
    with pytest.raises(ReportError, match="without a folder"):
        save_figures({"../one": made["one"]}, tmp_path)
    monkeypatch.setitem(sys.modules, "playwright.sync_api", None)
    with pytest.raises(BrowserError, match=r"pip install 'moc-opt\[figures\]'"):
        save_figures(made, tmp_path)
    assert list(tmp_path.iterdir()) == []
