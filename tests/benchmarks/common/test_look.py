"""What a benchmark shows of a trial: the map in its report and the replay beside it, in a real browser too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import moc_opt as mo
from benchmarks.common import look
from benchmarks.paper_experiment import page as paper_page
from benchmarks.paper_experiment.trials import BASELINES, MATCHED, Measurement, Outcome
from benchmarks.solver_study import look as solvers_look
from benchmarks.solver_study.closed_loop import POSES_EVERY, Run, finish
from moc_opt.errors import BrowserMissingError
from moc_opt.figures.style import Styles
from moc_opt.planning.swivel_map import End
from moc_opt.report import export
from moc_opt.report.page import Page
from moc_opt.scenario import Scenario
from moc_opt.study.trials import BASELINE
from moc_opt.trace.trace import Trace
from tests.conftest import opened

TRIAL = Scenario(duration_s=1.0, judge=False, bound_samples=0, start={"swivel": 0.2}, name="circle/0")


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    """The baseline, a solver, and one that broke off, as the study keeps them."""
    found = []
    for name, case in ((BASELINE, TRIAL.change(control={"law": "dcac"})), ("exact", TRIAL)):
        found.append(replace(finish(case, True, True, np.inf), controller=name))
    return [*found, Run("osqp", TRIAL.name, {}, error="hung")]


@pytest.fixture(scope="module")
def seen(runs: list[Run]) -> solvers_look.Look:
    found = solvers_look.look(TRIAL, runs)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def report(seen: solvers_look.Look, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The section of the study's report, alone on a page."""
    folder = tmp_path_factory.mktemp("look")
    page = Page("A report")
    seen.add_section(page, folder)
    return page.save(folder / "report.html")


# --- what is kept of a run ---


def test_poses_are_kept_thinned_and_the_rest_whole(runs: list[Run]) -> None:
    trace = mo.run(TRIAL)
    kept, drawn = runs[1].trace, runs[1].seen
    assert kept is not None
    assert drawn is not None
    assert len(kept) == len(trace)
    assert "q_rad" not in kept.columns
    np.testing.assert_allclose(drawn.q_rad, trace.q_rad[::POSES_EVERY], atol=1e-6)
    np.testing.assert_array_equal(drawn.mu, trace.mu[::POSES_EVERY])
    assert runs[2].seen is None
    assert finish(TRIAL, False, True, np.inf).seen is None


def test_the_trial_is_that_of_all_that_can_be_drawn(seen: solvers_look.Look) -> None:
    assert list(seen.traces) == [BASELINE, "exact"]
    assert not isinstance(seen.found, str)
    assert seen.found.mu.shape == (12, look.ROWS), "a second gets a dozen columns"
    rows = seen.rows()
    assert set(rows) == {BASELINE, "exact"}
    assert rows["exact"]["end"] in set(End)
    assert rows["exact"]["mu_share"] > rows[BASELINE]["mu_share"]
    assert solvers_look.look(TRIAL, []) is None


def test_the_best_is_the_first_of_those_that_are_as_good() -> None:
    given = {
        name: Trace({"mu": np.full(3, mu)})
        for name, mu in ((BASELINE, 0.4), ("a", 0.2), ("b", 0.29999), ("c", 0.3), ("d", 0.3))
    }
    assert solvers_look.baseline_and_best(given) == [BASELINE, "b"]
    assert solvers_look.baseline_and_best({BASELINE: given[BASELINE]}) == [BASELINE]


def test_a_report_without_a_map_says_why(runs: list[Run], tmp_path: Path) -> None:
    columns = {**runs[0].columns, "tip_ref_m": runs[0].columns["tip_ref_m"] + 0.01}
    torn = solvers_look.look(TRIAL, [runs[1], Run("moved", TRIAL.name, {}, columns)])
    nothing = solvers_look.look(TRIAL, runs[2:])
    for found, words in ((torn, "was given another path"), (nothing, "came to its end")):
        assert found is not None
        assert found.rows() == {}
        page = Page("A report")
        found.add_section(page, tmp_path)
        assert words in page.html()
    assert "There is no replay: 0 runs" in page.html()


# --- the paper's trials ---


def outcome(trial: str, gain: float, group: str = "tuned", traces: Any = None) -> Outcome:
    metrics = {"mu_gain_percent": gain}
    found = Measurement(group, "exact", "circle", trial, 0, "whole", metrics)
    return Outcome([found], {}, {"exact": 1} if traces is None else traces)


def test_the_trial_with_the_middle_gain_is_looked_at(monkeypatch: pytest.MonkeyPatch, robot: Any) -> None:
    monkeypatch.setattr(paper_page, "trial_map", lambda robot, traces: "none")
    drawn = [outcome("a", 5.0), outcome("b", 30.0), outcome("c", 7.0), outcome("c", 1.0, "paper"),
             outcome("e", 6.0, traces={})]  # fmt: skip
    [shown] = paper_page.looks(robot, drawn, "tuned", "exact")
    assert (shown.task, shown.trial, shown.gain_percent, shown.of) == ("circle", "c", 7.0, 3)
    assert shown.traces == {"MOC, exact": 1, "MOC, exact, group paper": 1}
    [shown] = paper_page.looks(robot, drawn[:2], "tuned", "exact")
    assert (shown.gain_percent, shown.of) == (5.0, 2)
    assert paper_page.looks(robot, drawn, "tuned", "rnn") == []


def test_the_papers_section_has_a_map_a_task_and_one_replay(seen: solvers_look.Look, tmp_path: Path) -> None:
    traces = {BASELINES[MATCHED]: seen.traces[BASELINE], "MOC, exact": seen.traces["exact"]}
    robot = TRIAL.robot.arm()
    shown = paper_page.Look("circle", "circle/0", 12.3, 5, traces, look.trial_map(robot, traces))
    none = paper_page.Look("spiral", "spiral/1", 1.0, 5, traces, "no such thing")
    page = Page("The paper")
    paper_page.add_looks(page, [shown, none], tmp_path, ("tuned", "exact"), robot)
    assert list(page.figures) == ["map-circle"]
    html = page.html()
    assert all(words in html for words in ("circle/0: +12.3 %, of 5 trials", "no such thing", 'href="replay.html"'))
    assert (tmp_path / "replay.html").stat().st_size > 10_000
    assert [(row["task"], row["name"]) for row in shown.rows()] == [("circle", name) for name in traces]


def test_a_replay_that_cannot_be_written_is_not_linked(robot: Any, runs: list[Run], tmp_path: Path) -> None:
    page = Page("A report")
    trace = runs[0].seen
    assert trace is not None
    (tmp_path / "file").write_text("")
    look.add_replay(page, tmp_path / "file", robot, {"a": trace}, "a", Styles(["a"]))
    assert "There is no replay" in page.html()
    assert 'href="replay' not in page.html()


# --- in a browser ---


@pytest.fixture(scope="module")
def page(report: Path) -> Iterator[Any]:
    looks = {"viewport": {"width": 900, "height": 800}, "color_scheme": "light", "device_scale_factor": 0.5}
    try:
        with (
            export.browser() as chromium,
            opened(chromium, report.as_uri(), "html[data-drawn=yes]", own=report.parent.as_uri(), **looks) as found,
        ):
            yield found
    except BrowserMissingError as missing:
        pytest.skip(str(missing))


def arm(page: Any) -> bytes:
    """The picture of the arm once it has come to rest."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    picture: bytes = page.locator("#scene").screenshot()
    return picture


def test_the_map_is_drawn_in_every_light(page: Any) -> None:
    assert page.locator("#map .heatmaplayer image").count() == 2
    drawn = "() => document.querySelectorAll('#map .scatterlayer .js-line').length"
    assert page.evaluate(drawn) >= 6, "an edge and a line for each course and for the best"
    page.emulate_media(color_scheme="dark")
    page.wait_for_function("document.querySelector('#map').layout.template.layout.font.color === '#e4e7ea'")
    page.set_viewport_size({"width": 360, "height": 740})
    page.wait_for_function("document.querySelector('#map .main-svg').getBoundingClientRect().width < 360")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.set_viewport_size({"width": 900, "height": 800})
    page.emulate_media(color_scheme="light")
    # Not the page alone: the plot in it gets the width back that the scale of colours had on the phone.
    page.wait_for_function("document.querySelector('#map .nsewdrag').getBoundingClientRect().width > 500")


def test_pointing_at_the_map_tells_mu_or_the_limit(page: Any) -> None:
    plot = page.locator("#map .nsewdrag")
    box = plot.bounding_box()
    for height, words in ((0.02, "beyond its limit"), (0.2, "µ = 0.")):
        plot.hover(position={"x": 0.6 * box["width"], "y": height * box["height"]})
        page.wait_for_function(
            f"document.querySelector('#map .hoverlayer').textContent.includes('{words}')", timeout=5000
        )


def test_the_legend_switches_a_course_off(page: Any) -> None:
    hidden = "() => document.querySelector('#map').data.filter(t => t.visible === 'legendonly').map(t => t.legendgroup)"
    assert page.evaluate(hidden) == []
    page.locator("#map .legendtoggle").nth(1).click()
    page.wait_for_function(f"({hidden})().length > 0")
    assert set(page.evaluate(hidden)) == {"exact"}
    page.locator("#map .legendtoggle").nth(1).click()
    page.wait_for_function(f"({hidden})().length === 0")


def test_the_link_opens_the_replay_and_the_arm_moves(page: Any) -> None:
    page.locator("a[href='replay.html']").click()
    page.wait_for_selector("#scene")
    page.wait_for_selector("html[data-drawn=yes]", timeout=60_000)
    assert page.locator("#labels b").all_inner_texts() == [BASELINE, "exact"]
    page.evaluate("replay.seek(0)")
    before = arm(page)
    page.evaluate("replay.seek(0.9)")
    assert arm(page) != before
    page.go_back()
    page.wait_for_selector("html[data-drawn=yes]", timeout=60_000)
