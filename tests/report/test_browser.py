"""Pages in a real browser: they open without errors or requests, sort, switch, and fit a phone and a sheet of paper.

Skipped where playwright or a Chromium is missing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moc_opt import figures
from moc_opt.figures.style import DARK, INK
from moc_opt.report import export
from moc_opt.report.export import save_figures
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Missing, Table
from tests.conftest import opened


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a wide table and every kind of figure."""
    rng = np.random.default_rng(2)
    names = [f"solver-{k}" for k in range(9)]
    times = {name: rng.lognormal(k, 0.2, 400) for k, name in enumerate(names)}
    t = 0.002 * np.arange(3000)
    errors = {"tip_error_m": 1e-4, "rcm_error_m": 1e-3, "trocar_force_N": 1.0}
    runs = {
        name: {"t_s": t, "mu": mean + 0.01 * np.sin(t)}
        | {column: size * rng.random(3000) for column, size in errors.items()}
        for name, mean in (("DCAC", 0.27), ("MOC", 0.3))
    }
    page = Page("A report", "of made-up numbers")
    page.headline("Nothing is found.")
    page.section("Table")
    columns = [Column("name", "solver"), Column("value", "time", "us", better="low", help="of a solve")]
    columns += [Column(f"c{k}", f"column {k}", "rad/s") for k in range(12)]
    values = [2.5, Missing("no licence"), 1e-3, float("inf"), 30.0, -4.0]
    page.table(
        Table("Times", columns, [{"name": names[k], "value": value} for k, value in enumerate(values)])
    )
    page.section("Figures")
    page.figure(figures.time_series(runs), "Runs.", name="runs")
    page.figure(figures.latency_ecdf(times, 2000.0), "Times.", name="ecdf")
    page.figure(
        figures.box_plots({n: {"circle": v, "line": v} for n, v in times.items()}, "y", log=True), "Boxes."
    )
    points = {name: (float(k + 1), 10.0**-k) for k, name in enumerate(names)}
    page.figure(figures.accuracy_against_time(points), "Accuracy.", name="accuracy")
    page.environment({"seed": 2, "machine": {"a_rather_long_key_without_any_gap_in_it": "x" * 200}})
    return page.save(tmp_path_factory.mktemp("report") / "report.html")


POLLING_MS = 50
DRAWN = "html[data-drawn=yes]"


@pytest.fixture(scope="module")
def page(chromium: Any, report: Path) -> Iterator[Any]:
    """Opened once: a browser that shares its processor takes seconds to draw it."""
    size = {"width": 1000, "height": 800}
    with opened(chromium, report.as_uri(), DRAWN, viewport=size, color_scheme="light") as found:
        yield found


def lit(page: Any, scheme: str) -> None:
    """Switch to the dark or the light, and wait until the figures have followed."""
    page.emulate_media(color_scheme=scheme)
    color = DARK[INK] if scheme == "dark" else INK
    page.wait_for_function(
        f"document.querySelector('#ecdf').layout.template.layout.font.color === '{color}'", polling=POLLING_MS
    )


def column(page: Any, place: int) -> list[str]:
    return [text.strip() for text in page.locator(f"tbody tr > :nth-child({place})").all_inner_texts()]


def test_every_figure_is_drawn(page: Any) -> None:
    charts = page.eval_on_selector_all(
        ".chart", "charts => charts.map(c => c.querySelectorAll('.main-svg').length)"
    )
    assert len(charts) == 4
    assert min(charts) >= 1


def test_a_heading_sorts_by_mouse_and_keyboard(page: Any) -> None:
    before = column(page, 1)
    heading = page.locator("th[scope=col]").nth(1)
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "ascending"
    names = [f"solver-{k}" for k in (5, 2, 0, 4, 3, 1)]
    assert column(page, 1) == names
    assert column(page, 2)[-2:] == ["∞", "–a"], "the missing value is last"
    page.keyboard.press("Enter")
    assert heading.get_attribute("aria-sort") == "descending"
    assert column(page, 1) == [*names[:5][::-1], names[5]]
    page.locator("th[scope=col] button").first.press("Space")
    assert heading.get_attribute("aria-sort") == "none"
    assert column(page, 1) == before


def test_the_legend_hides_a_run_in_every_panel_and_in_every_light(page: Any) -> None:
    shown = "() => document.querySelector('#runs').data.map(trace => trace.visible ?? true)"
    assert page.evaluate(shown) == [True] * 8
    lines = page.locator("#runs .scatterlayer .js-line")
    assert lines.count() == 8
    page.locator("#runs .legendtoggle").first.click()
    page.wait_for_function(
        "document.querySelectorAll('#runs .scatterlayer .js-line').length === 4", polling=POLLING_MS
    )
    lit(page, "dark")
    assert page.evaluate(shown).count("legendonly") == 4
    assert lines.count() == 4
    page.locator("#runs .legendtoggle").first.click()
    page.wait_for_function(
        "document.querySelectorAll('#runs .scatterlayer .js-line').length === 8", polling=POLLING_MS
    )


@pytest.mark.parametrize(("begins", "width"), [(360, 360), (1000, 360)])
def test_nothing_is_wider_than_the_screen(chromium: Any, report: Path, begins: int, width: int) -> None:
    size = {"width": begins, "height": 800}
    with opened(chromium, report.as_uri(), DRAWN, viewport=size, color_scheme="light") as page:
        page.set_viewport_size({"width": width, "height": 800})
        widest = "[...document.querySelectorAll('.chart .main-svg')].every(s => s.getBoundingClientRect().right <= "
        page.wait_for_function(f"{widest}{width})", polling=POLLING_MS)
        page.evaluate("document.querySelectorAll('details').forEach(block => { block.open = true })")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        inner, outer = page.locator(".scroll").evaluate("box => [box.scrollWidth, box.clientWidth]")
        assert inner > outer, "the table scrolls in its own box"


def test_figures_are_saved_as_vectors(chromium: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = figures.box_plots({"DCAC": {"circle": [1.0, 2.0, 3.0]}}, "error [mm]")
    # playwright runs one browser at a time in a thread: lend it the module's.
    monkeypatch.setattr(export, "browser", lambda: contextlib.nullcontext(chromium))
    files = save_figures({"one": made, "two": made}, tmp_path / "new")
    assert [file.name for file in files] == ["one.svg", "one.pdf", "two.svg", "two.pdf"]
    assert files[0].read_text(encoding="utf-8").startswith("<svg")
    assert "error [mm]" in files[0].read_text(encoding="utf-8")
    pdf = files[1].read_bytes()
    assert pdf.startswith(b"%PDF")
    assert b"/Subtype /Image" not in pdf
    assert pdf.count(b"/Type /Page\n") == 1
