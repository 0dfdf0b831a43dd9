"""The first screen: three sentences, a table that fits 80 characters, pictures that say what to see."""

from __future__ import annotations

import io
import re
from typing import Any

import pytest
from rich.console import Console

from benchmarks.common.answer import Answer
from benchmarks.solver_study.first_screen import answer
from benchmarks.solver_study.tables import INCONSISTENT
from moc_opt.report.document import anchor
from moc_opt.report.page import Page
from moc_opt.study.statistics import Change, Interval

LOOP = {
    "mu_mean": 0.3, "tip_error_model_mean_mm": 0.2, "rcm_error_model_mean_mm": 0.4, "torque_rate_rms_Nm_per_s": 600.0,
    "runs": 15, "compared_trials": 15, "mu_fraction_of_bound": 0.947,
    "tick_p50_us": 37.0, "tick_p99_us": 105.0, "tick_p99_9_us": 211.0,
    **Change(Interval(8.62, 5.2, 13.0, 15), Interval(9.1, 5.3, 14.0, 15)).entries("mu_gain_percent"),
    **Change(Interval(1.9, -3.5, 7.8, 15), Interval(11.0, 3.0, 21.0, 15)).entries("tip_change_percent"),
    **Change(Interval(119.0, 80.0, 160.0, 15), Interval(150.0, 90.0, 230.0, 15)).entries("tip_patient_change_percent"),
    **Change(Interval(4.4, -5.0, 14.0, 15), Interval(5.0, -4.0, 16.0, 15)).entries("rcm_change_percent"),
    **Change(Interval(19.0, 6.0, 33.0, 15), Interval(47.0, 20.0, 80.0, 15)).entries("rcm_patient_change_percent"),
}  # fmt: skip
LONG = "qpsolvers:a-library-whose-name-is-far-too-long-for-a-table"


def certified(right: int, **more: Any) -> dict[str, Any]:
    """Return counts of which 179 are infeasible problems, all recognised."""
    asked = {"optima_asked": 1869, "infeasible_asked": 179, "refused_inconsistent": 0, "inconsistent_asked": 0}
    found = {"verified_solved": right - 179, "claimed_solved": right - 179, "infeasible_right": 179}
    return {"solves": 2048, "right": right, "silently_wrong": 0, "relative_max": 1e-8, **asked, **found, **more}


def timed(us: float) -> dict[str, Any]:
    found = {"optima_asked": 1000, "verified_solved": 1000, "infeasible_asked": 0, "refused_inconsistent": 0}
    return {"solves": 1000, "right": 1000, "solve_p50_us": us, "solve_p99_us": 1.5 * us, **found}


@pytest.fixture(scope="module")
def summary() -> dict[str, Any]:
    names = {"exact": 1.2, "clarabel": 48.5, "qpsolvers:highs": 908.7, "nlp-ipopt": 1244.8, LONG: 12345.6}
    rights = {"exact": 1799, "clarabel": 2048, "qpsolvers:highs": 1767, "nlp-ipopt": 268, LONG: 1000}
    sets = {f"{name}@recommended": certified(right) for name, right in rights.items()}
    sets["exact@recommended"] |= {"optima_asked": 1621, "refused_inconsistent": 248, "inconsistent_asked": 621}
    sets["qpsolvers:highs@recommended"] |= {"silently_wrong": 1}
    sets["nlp-ipopt@recommended"] |= {"silently_wrong": 1776}
    sets["osqp@default"] = certified(629, silently_wrong=1301)
    sets["qpsolvers:scs@default"] = certified(629, silently_wrong=432)
    sets["quadprog@default"] = certified(629)
    return {
        "testsets": sets, "open_loop_warm": {name: timed(us) for name, us in names.items()},
        "closed_loop": {
            "dcac": LOOP, **{name: {**LOOP, "tick_p99_9_us": 211.0 + 2.0 * us} for name, us in names.items()},
        },
        "settings": {"exact@recommended": {"options": "", "reason": "nothing to set"}},
    }  # fmt: skip


def printed(first: Answer, width: int) -> str:
    screen = Console(file=io.StringIO(), width=width, color_system=None, highlight=False)
    for part in first.screens(width):
        screen.print(part, markup=False)
    written: str = screen.file.getvalue()  # type: ignore[attr-defined]
    return written


def test_the_answer_comes_in_three_sentences(summary):
    take, sound, avoid = answer(summary, 2000.0).sentences
    assert take.startswith("Take `exact` (nothing to set): ")
    for counted in ("1620 of 1621 certified optima", "179 of 179 infeasible", "248 of 621 with inconsistent rows"):
        assert counted in take
    assert "`clarabel` (48 us)" in sound
    assert "mean mu by +8.6 [5.2, 13] %" in sound
    assert "15 independent trials" in sound
    assert "+1.9 [-3.5, 7.8] % (mean of ratios +11 [3, 21] %: undecided)" in sound  # both means where they disagree
    assert "by +119 [80, 160] % in the frame registered at the start" in sound
    assert "`qpsolvers:highs` (1 silently wrong)" in avoid
    assert "`osqp` 1301, `qpsolvers:scs` 432" in avoid
    assert "2 of 3 solvers" in avoid
    assert "nlp" not in avoid


def test_refusals_are_explained_where_there_are_any(summary):
    rows = {row["solver"]: row for row in answer(summary, 2000.0).table.rows}
    assert rows["exact"]["right_percent"] == pytest.approx(100.0 * 1799 / 1800)
    assert INCONSISTENT in answer(summary, 2000.0).table.caption
    without = {**summary, "testsets": {**summary["testsets"], "exact@recommended": certified(2048)}}
    assert INCONSISTENT not in answer(without, 2000.0).table.caption
    (take, *_) = answer(without, 2000.0).sentences
    assert "refused" not in take


def test_few_trials_claim_no_gain(summary):
    rows = summary["closed_loop"].items()
    few = {**summary, "closed_loop": {name: {**row, "compared_trials": 4} for name, row in rows}}
    first = answer(few, 2000.0)
    assert "mu by" not in " ".join(first.sentences)
    assert "too few trials to decide (4 of at least 8)" in " ".join(first.sentences)
    assert not any("tip_change" in row for row in first.table.rows)
    assert "too few" in first.pictures[1].says


@pytest.mark.parametrize("width", [60, 80, 132])
def test_the_table_fits_a_terminal_and_loses_no_column(summary, width):
    text = printed(answer(summary, 2000.0), width)
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    assert "..." not in text
    assert all(piece in re.sub(r"\s", "", text) for piece in (LONG[:12], LONG[-4:])), "broken, but whole"
    for heading in ("solver", "verdict", "verified", "silently", "p50", "p99", "patient", "bound", "damage", "trials"):
        assert heading in text
    assert "+2?/+119" in text  # the two means of the first disagree


def test_every_link_has_its_section_and_what_comes_after_is_folded(summary):
    first = answer(summary, 2000.0)
    page = Page("t")
    first.begin(page)
    from benchmarks.solver_study import first_screen

    for title in (first_screen.CERTIFIED, first_screen.RECORDED, first_screen.CLOSED_LOOP, first_screen.RULES):
        page.section(title)
        page.text("more")
    source = page.html()
    targets = set(re.findall(r'<td[^>]*><a href="#([^"]+)"', source))
    assert targets == {anchor(column.section) for column in first.table.columns if column.section}
    assert len(targets) == 4
    for target in targets:
        assert f'<details class="section" id="{target}">' in source
    assert source.count("<details") == source.count("</details>")


def test_three_pictures_say_what_to_see(summary):
    seen, effect, late = answer(summary, 2000.0).pictures
    assert "nothing beats exact in both" in seen.says
    assert "none surely lost some" in effect.says
    assert "nlp-ipopt" in late.says
    assert "clarabel" not in late.says
    assert "all meet the deadline" in answer(summary, 1e6).pictures[2].says


def test_the_answer_grows_with_the_study(summary):
    assert answer({}, 2000.0).sentences == ["Nothing was run."]
    early = answer({"open_loop_warm": summary["open_loop_warm"]}, 2000.0)
    assert early.pictures == []
    assert "exact" in printed(early, 80)
