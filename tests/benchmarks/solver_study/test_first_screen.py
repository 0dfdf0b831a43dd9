"""The first screen: three sentences, a table of eight columns on 80 characters, pictures that say what to see."""

from __future__ import annotations

import io
import re
from typing import Any

import pytest
from rich.console import Console

from benchmarks.common.answer import MOST_COLUMNS, Answer
from benchmarks.solver_study.first_screen import answer
from moc_opt.report.document import anchor
from moc_opt.report.page import Page

LOOP = {
    "mu_mean": 0.3, "tip_error_model_mean_mm": 0.2, "rcm_error_model_mean_mm": 0.4, "torque_rate_rms_Nm_per_s": 600.0,
    "runs": 15, "mu_fraction_of_bound": 0.947, "mu_gain_percent": 8.62, "mu_gain_percent_low": 5.2,
    "mu_gain_percent_high": 13.0, "tick_p50_us": 37.0, "tick_p99_us": 105.0, "tick_p99_9_us": 211.0,
}  # fmt: skip
LONG = "qpsolvers:a-library-whose-name-is-far-too-long-for-a-table"


def certified(right: int, **more: Any) -> dict[str, Any]:
    return {"solves": 2048, "right": right, "claimed_solved": right, "silently_wrong": 0, "relative_max": 1e-8, **more}


def timed(us: float) -> dict[str, Any]:
    return {"solves": 1000, "right": 1000, "solve_p50_us": us, "solve_p99_us": 1.5 * us}


@pytest.fixture(scope="module")
def summary() -> dict[str, Any]:
    names = {"exact": 1.2, "clarabel": 48.5, "qpsolvers:highs": 908.7, "nlp-ipopt": 1244.8, LONG: 12345.6}
    rights = {"exact": 2047, "clarabel": 2048, "qpsolvers:highs": 1767, "nlp-ipopt": 268, LONG: 1000}
    sets = {f"{name}@recommended": certified(right) for name, right in rights.items()}
    sets["qpsolvers:highs@recommended"] |= {"silently_wrong": 1}
    sets["nlp-ipopt@recommended"] |= {"silently_wrong": 1776}
    sets["osqp@default"] = certified(629, silently_wrong=1301)
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
    assert take.startswith("Take `exact` (nothing to set): 2047 of 2048 certified problems answered rightly")
    assert "`clarabel` (48 us)" in sound
    assert "8.6 [5.2, 13] %" in sound
    assert "(15 trials)" in sound
    assert "`qpsolvers:highs` (1 silently wrong)" in avoid
    assert "osqp 1301" in avoid
    assert "nlp" not in avoid


def test_few_trials_claim_no_gain(summary):
    few = {**summary, "closed_loop": {name: {**row, "runs": 4} for name, row in summary["closed_loop"].items()}}
    assert "mu by" not in " ".join(answer(few, 2000.0).sentences)


@pytest.mark.parametrize("width", [60, 80, 132])
def test_eight_columns_fit_a_terminal(summary, width):
    text = printed(answer(summary, 2000.0), width)
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    assert "..." not in text
    assert all(piece in re.sub(r"\s", "", text) for piece in (LONG[:12], LONG[-4:])), "broken, but whole"
    if width >= 80:
        for heading in ("solver", "verdict", "verified", "silently", "p50", "p99", "bound", "damage"):
            assert heading in text
    assert len(answer(summary, 2000.0).table.columns) <= MOST_COLUMNS


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
    assert "all solvers have about the same" in effect.says
    assert "nlp-ipopt" in late.says
    assert "clarabel" not in late.says
    assert "all meet the deadline" in answer(summary, 1e6).pictures[2].says


def test_the_answer_grows_with_the_study(summary):
    assert answer({}, 2000.0).sentences == ["Nothing was run."]
    early = answer({"open_loop_warm": summary["open_loop_warm"]}, 2000.0)
    assert early.pictures == []
    assert "exact" in printed(early, 80)
