"""What the paper's report shows of a trial: a map a task, and one replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.common import look
from benchmarks.paper_experiment import page as paper_page
from benchmarks.paper_experiment.trials import BASELINES, MATCHED, Measurement, Outcome
from moc_opt.report.page import Page
from moc_opt.scenario import Scenario
from moc_opt.study.trials import BASELINE, Trial, run_trial

TRIAL = Scenario(duration_s=1.0, judge=False, bound_samples=0, start={"swivel": 0.2}, name="circle/0")


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


def test_the_papers_section_has_a_map_a_task_and_one_replay(tmp_path: Path) -> None:
    base, mine = (run_trial(Trial(TRIAL, name, keep="poses")).trace for name in (BASELINE, "exact"))
    traces: Any = {BASELINES[MATCHED]: base, "MOC, exact": mine}
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
