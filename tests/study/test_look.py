"""What a report shows of one trial: every run on the map, and the baseline beside the best in the replay."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import BrowserMissingError
from moc_opt.report import export
from moc_opt.report.page import Page
from moc_opt.scenario import Scenario
from moc_opt.study import look
from moc_opt.study.trials import BASELINE, POSES_EVERY, Trial, run_trial
from moc_opt.trace.trace import Trace
from tests.conftest import opened

TRIAL = Scenario(duration_s=1.0, judge=False, bound_samples=0, start={"swivel": 0.2}, name="circle/0")
ROBOT = TRIAL.robot.arm()


@pytest.fixture(scope="module")
def traces() -> dict[str, Trace]:
    found = {name: run_trial(Trial(TRIAL, name, keep="poses")).trace for name in (BASELINE, "exact")}
    return {name: trace for name, trace in found.items() if trace is not None}


@pytest.fixture(scope="module")
def report(traces: dict[str, Trace], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, page = tmp_path_factory.mktemp("look"), Page("A report")
    look.add_look(page, folder, ROBOT, traces, TRIAL.name)
    return page.save(folder / "report.html")


def test_poses_are_kept_thinned_and_are_those_of_the_run(traces: dict[str, Trace]) -> None:
    trace = mo.run(TRIAL)
    np.testing.assert_allclose(traces["exact"].q_rad, trace.q_rad[::POSES_EVERY], atol=1e-6)
    np.testing.assert_array_equal(traces["exact"].mu, trace.mu[::POSES_EVERY])
    np.testing.assert_array_equal(traces["exact"].trocar_force_N, trace.trocar_force_N[::POSES_EVERY])
    assert run_trial(Trial(TRIAL, "exact", keep="curves")).trace is None


def test_a_second_gets_a_dozen_columns(traces: dict[str, Trace]) -> None:
    found = look.trial_map(ROBOT, traces)
    assert not isinstance(found, str)
    assert found.mu.shape == (12, look.ROWS)
    assert set(found.trajectories) == {BASELINE, "exact"}


def test_the_best_is_the_first_of_those_that_are_as_good() -> None:
    given = {
        name: Trace({"mu": np.full(3, mu)})
        for name, mu in ((BASELINE, 0.4), ("a", 0.2), ("b", 0.29999), ("c", 0.3), ("d", 0.3))
    }
    assert look.baseline_and_best(given) == [BASELINE, "b"]
    assert look.baseline_and_best({BASELINE: given[BASELINE]}) == [BASELINE]


def test_a_report_without_a_map_or_a_replay_says_why(traces: dict[str, Trace], tmp_path: Path) -> None:
    moved = {**traces["exact"].columns, "tip_ref_m": traces["exact"].tip_ref_m + 0.01}
    (tmp_path / "file").write_text("")
    for given, folder, words in (
        ({**traces, "moved": Trace(moved)}, tmp_path, "was given another path"), ({}, tmp_path, "came to its end"),
        ({}, tmp_path, "There is no replay: 0 runs"), (traces, tmp_path / "file", "There is no replay"),
    ):  # fmt: skip
        page = Page("A report")
        look.add_look(page, folder, ROBOT, given, "circle/0")
        assert words in page.html()


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
