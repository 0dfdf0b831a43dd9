"""Pages are self-contained and work in a browser."""

import base64
import gzip
import json
import re
import sys
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from moc_opt import figures
from moc_opt.errors import BrowserError, ReportError
from moc_opt.report.export import browser, save_figures
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Missing, Table
from moc_opt.robots.model import RobotModel
from tests.conftest import opened
from tests.odd_inputs import names
from tests.report.test_replay import wave


class Resources(HTMLParser):
    def __init__(self, source: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.tags: list[tuple[str, ...]] = []
        self.data: dict[str, str] = {}
        self._inside = self.styles = ""
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = {key: value or "" for key, value in attrs}
        self.tags.append((tag, *known))
        for name in ("src", "href", "srcset", "data", "poster", "action", "background", "xlink:href"):
            if known.get(name) and (tag, name) != ("a", "href"):
                self.fetched.append(known[name])
        self.styles += known.get("style", "")
        self._inside = known.get("id", tag) if tag in ("script", "style") else ""

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "style":
            self.styles += data
        elif self._inside:
            self.data[self._inside] = data


@pytest.fixture(scope="module")
def full(robot: RobotModel) -> Page:
    """Return a page with all kinds of parts, and text that looks like markup."""
    rng = np.random.default_rng(2)
    solvers = [f"solver-{k}" for k in range(9)]
    times = {name: rng.lognormal(k, 0.2, 400) for k, name in enumerate(solvers)}
    runs = {"DCAC": wave(robot, 3000), "MOC": wave(robot, 3000, phase=1.0)}
    page = Page("A report <b>", "of made-up numbers")
    page.headline("Nothing is found.")
    page.section("Results")
    page.text("First <b>\n\nSecond `name`.")
    columns = [Column("name", "solver"), Column("value", "time", "us", better="low", help="of a solve")]
    columns += [Column(f"c{k}", f"column {k}", "rad/s") for k in range(12)]
    values = [2.5, Missing("no licence"), 1e-3, float("inf"), 30.0, -4.0]
    page.table(Table("Times", columns, [{"name": solvers[k], "value": value} for k, value in enumerate(values)]))
    page.section("Results")
    page.figure(figures.time_series(runs), "Runs.", name="runs")
    page.figure(figures.latency_ecdf(times), "Times.", name="ecdf")
    boxes = {name: {"circle": of, "<b>": of} for name, of in times.items()}
    page.figure(figures.box_plots(boxes, "y"), "The same words twice over again")
    points = {name: (float(k + 1), 10.0**-k) for k, name in enumerate(solvers)}
    page.figure(figures.accuracy_against_time(points), "The same words twice over indeed")
    page.environment({"seed": 3, "machine": {"a_rather_long_key_without_any_gap_in_it": "x" * 200, "none": None}})
    return page


def test_page_loads_nothing_from_elsewhere(full: Page) -> None:
    found = Resources(full.html())
    assert [address for address in found.fetched if not address.startswith("data:")] == []
    assert not {"@import", "url("} & set(re.findall(r"@import|url\(", found.styles))
    assert not re.search(r"\b(fetch|XMLHttpRequest|import|WebSocket|sendBeacon)\s*\(", "".join(found.data.values()))
    assert "link" in {tag for tag, *_ in found.tags}, "a browser requests an icon unless the page names one"
    for name, figure in full.figures.items():
        assert json.loads(found.data[f"{name}-data"]) == json.loads(figure.to_json())
    assert "plotly.js v" in gzip.decompress(base64.b64decode(found.data["plotly-packed"])).decode()[:200]
    assert len(set(full.figures)) == 4


def tags(text: str) -> list[tuple[str, ...]]:
    made = Page(text, text)
    made.headline(text)
    made.section(text)
    made.table(Table(text, [Column("name", text, help=text)], [{"name": text}]))
    made.fold()
    made.environment({"solver": text, "deeper": {text: text}})
    return Resources(made.html()).tags


@cache
def plain() -> list[list[tuple[str, ...]]]:
    return [tags(each) for each in ("a", "", "a `b`\n\nc", "long " * 20, "1.5")]


@given(text=names)
def test_no_name_makes_a_tag_an_attribute_or_a_script(text: str) -> None:
    found = tags(text)
    assert set(found) <= {tag for page in plain() for tag in page}
    assert sum(tag == "script" for tag, *_ in found) == sum(tag == "script" for tag, *_ in plain()[0])


def test_saving_twice_gives_the_same_bytes(full: Page, tmp_path: Path) -> None:
    first, second = full.save(tmp_path / "a" / "report.html"), full.save(tmp_path / "b.html")
    old = first.read_bytes()
    assert old == second.read_bytes()
    assert len(old) < 3_000_000
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["a", "b.html", "report.html"]


def test_unsavable_figures_are_refused(full: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = full.figures["ecdf"]
    with pytest.raises(ReportError, match="without a folder"):
        save_figures({"../one": one}, tmp_path)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv("MOC_OPT_BROWSER", "no-such-program")
    with pytest.raises(BrowserError, match="is no program"):
        browser().__enter__()
    monkeypatch.setitem(sys.modules, "playwright.sync_api", None)
    with pytest.raises(BrowserError, match=r"pip install '.\[figures\]'"):
        browser().__enter__()


@pytest.fixture(scope="module")
def page(chromium: Any, full: Page, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    report = full.save(tmp_path_factory.mktemp("report") / "report.html")
    size = {"width": 1000, "height": 800}
    with opened(chromium, report.as_uri(), "html[data-drawn=yes]", viewport=size, color_scheme="light") as found:
        yield found


def column(page: Any, place: int) -> list[str]:
    return [text.strip() for text in page.locator(f"tbody tr > :nth-child({place})").all_inner_texts()]


def test_column_heading_sorts_the_table_on_click_enter_and_space(page: Any) -> None:
    before = column(page, 1)
    heading = page.locator("th[scope=col]").nth(1)
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "ascending"
    sorted_names = [f"solver-{k}" for k in (5, 2, 0, 4, 3, 1)]
    assert column(page, 1) == sorted_names
    assert column(page, 2)[-2:] == ["∞", "–a"], "the missing value is last"
    page.keyboard.press("Enter")
    assert heading.get_attribute("aria-sort") == "descending"
    assert column(page, 1) == [*sorted_names[:5][::-1], sorted_names[5]]
    page.locator("th[scope=col] button").first.press("Space")
    assert heading.get_attribute("aria-sort") == "none"
    assert column(page, 1) == before


def test_nothing_is_wider_than_the_screen(page: Any) -> None:
    for width in (1000, 360):
        page.set_viewport_size({"width": width, "height": 800})
        widest = "[...document.querySelectorAll('.chart .main-svg')].every(s => s.getBoundingClientRect().right <= "
        page.wait_for_function(f"{widest}{width})", polling=50)
        page.evaluate("document.querySelectorAll('details').forEach(block => { block.open = true })")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        inner, outer = page.locator(".scroll").evaluate("box => [box.scrollWidth, box.clientWidth]")
        assert inner > outer, "the table scrolls in its own box"


def test_figures_are_saved_as_vector_graphics(chromium: Any, tmp_path: Path) -> None:
    made = figures.box_plots({"DCAC": {"circle": [1.0, 2.0, 3.0]}}, "error [mm]")
    files = save_figures({"one": made, "two": made}, tmp_path / "new")
    assert [file.name for file in files] == ["one.svg", "one.pdf", "two.svg", "two.pdf"]
    svg, pdf = files[0].read_text(encoding="utf-8"), files[1].read_bytes()
    assert svg.startswith("<svg")
    assert "error [mm]" in svg
    assert pdf.startswith(b"%PDF")
    assert b"/Subtype /Image" not in pdf
    assert pdf.count(b"/Type /Page\n") == 1
