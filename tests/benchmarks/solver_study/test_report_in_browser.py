"""The solvers' report in a browser: short before it is unfolded, readable on a phone, links open what they lead to."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.solver_study.config import Config
from benchmarks.solver_study.first_screen import CERTIFIED, answer
from benchmarks.solver_study.report import report_page
from benchmarks.solver_study.study import Findings, Study
from benchmarks.solver_study.tables import tables
from moc_opt.report.document import anchor

MOST_PX = 8000
NAMES = [f"qpsolvers:solver-{k}" for k in range(20)]


@pytest.fixture(scope="module")
def page(chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A report of twenty solvers and sixteen sets, opened."""
    counts = dict.fromkeys(("feasible", "optima_asked", "claimed_solved", "verified_solved", "right", "solves"), 100)
    counts |= {"hung": 0, "crashed": 0, "infeasible_asked": 0, "refused_inconsistent": 0}
    rows = {
        f"{name}@{setting}": {**counts, "silently_wrong": k, "primal_max": 1e-9, "relative_max": 10.0**-k,
                              "solve_p50_us_worst_set": 5.0 + k, "solve_p99_us_worst_set": 9.0 + k}
        for k, name in enumerate(NAMES) for setting in ("recommended", "default", "tight")
    }  # fmt: skip
    closed = {
        name: {"runs": 15, "compared_trials": 15, "mu_mean": 0.3,
               "mu_gain_percent": 8.0 + k, "mu_gain_percent_low": 5.0,
               "mu_gain_percent_high": 30.0, "tick_p50_us": 40.0, "tick_p99_us": 80.0, "tick_p99_9_us": 200.0}
        for k, name in enumerate(["dcac", *NAMES])
    }  # fmt: skip
    summary = {"testsets": rows, "closed_loop": closed, **{f"testset {k}": rows for k in range(16)}, "not_run": {}}
    out = tmp_path_factory.mktemp("report")
    study, found = Study(Config(), NAMES, out, print), Findings(summary)
    made = report_page(study, found, tables(summary), {"seed": 0}, None, answer(summary, 2000.0))
    opened = chromium.new_page(viewport={"width": 1280, "height": 900})
    opened.goto(made.save(Path(out) / "report.html").as_uri())
    opened.wait_for_selector("html[data-drawn=yes]", timeout=60_000)
    yield opened
    opened.close()


@pytest.fixture(autouse=True)
def afresh(page: Any) -> None:
    """Every test finds the page folded, and as wide as a screen."""
    page.set_viewport_size({"width": 1280, "height": 900})
    page.locator("#find").fill("")
    page.evaluate("document.querySelectorAll('details').forEach(block => { block.open = false; block.hidden = false })")
    page.evaluate("history.replaceState(null, '', location.pathname)")


def height(page: Any) -> int:
    return int(page.evaluate("document.documentElement.scrollHeight"))


def test_it_is_short_until_it_is_unfolded(page: Any) -> None:
    folded = height(page)
    assert folded <= MOST_PX
    page.locator("#unfold").click()
    assert height(page) > 2 * MOST_PX, "there is something to unfold"


def test_on_a_phone_tables_scroll_and_the_page_does_not(page: Any) -> None:
    page.locator("#unfold").click()
    page.set_viewport_size({"width": 390, "height": 800})
    page.wait_for_function("[...document.querySelectorAll('.chart')].every(c => c.clientWidth <= 390)", polling=50)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    wide = page.evaluate("[...document.querySelectorAll('.scroll')].some(b => b.scrollWidth > b.clientWidth)")
    assert wide, "a table is wider than the phone"


def test_a_number_leads_to_what_explains_it(page: Any) -> None:
    target = page.locator(f"#{anchor(CERTIFIED)}")
    assert target.get_attribute("open") is None
    page.locator(f"td a[href='#{anchor(CERTIFIED)}']").first.click()
    place = f"document.getElementById('{anchor(CERTIFIED)}')"
    page.wait_for_function(f"{place}.open && Math.abs({place}.getBoundingClientRect().top) < 100", polling=50)


def test_a_search_leaves_the_rows_that_hold_it(page: Any) -> None:
    page.locator("#find").fill("SOLVER-19@tight")
    page.wait_for_function("document.getElementById('found').value.endsWith('rows')", polling=50)
    shown = page.evaluate(
        "[...document.querySelectorAll('details.section tbody tr')].filter(r => r.checkVisibility())"
        ".map(r => r.cells[0].textContent.trim())"
    )
    assert len(shown) == 17
    assert set(shown) == {"qpsolvers:solver-19@tight"}
    assert page.evaluate("document.querySelector('figure.table tbody').rows.length") == 20, "the answer stays whole"
