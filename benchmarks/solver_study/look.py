"""The first closed-loop trial of the study: where each solver took the elbow, and two arms side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.common.look import add_replay, trial_map
from benchmarks.solver_study.closed_loop import Run
from moc_opt.figures.style import Styles
from moc_opt.planning.swivel_map import SwivelMap, read_trajectory
from moc_opt.report.map_page import add_map
from moc_opt.report.page import Page
from moc_opt.scenario import Scenario
from moc_opt.study.trials import BASELINE
from moc_opt.trace.trace import Trace

EQUAL = 1e-3  # mean mu that differs by less is no reason to prefer one solver to another


@dataclass(frozen=True)
class Look:
    """The runs of one trial that can be drawn, and their map or the reason why there is none."""

    scenario: Scenario
    trial: str
    traces: Mapping[str, Trace]
    found: SwivelMap | str

    def rows(self) -> dict[str, dict[str, Any]]:
        """Return controller -> what its course amounts to."""
        if isinstance(self.found, str):
            return {}
        return {name: asdict(read_trajectory(self.found, name)) for name in self.found.trajectories}

    def add_section(self, page: Page, folder: Path) -> None:
        """Append the map, and write the replay to ``folder``, which the page will lie in."""
        styles = Styles(self.traces)
        page.section("Where the elbow goes")
        if isinstance(self.found, str):
            page.text(f"There is no map of trial {self.trial}: {self.found}")
        else:
            cut = self.scenario.duration_s
            page.text(
                f"Trial {self.trial} under every controller"
                + (f", its first {cut:g} s" if cut else "")
                + ". Of controllers whose elbows go the same way one is drawn; the table names the others."
            )
            add_map(page, self.found, what=f"trial {self.trial}", styles=styles)
        pair = {name: self.traces[name] for name in baseline_and_best(self.traces)}
        add_replay(page, folder, self.scenario.robot.arm(), pair, f"Trial {self.trial}: {' and '.join(pair)}", styles)


def look(scenario: Scenario, runs: Sequence[Run]) -> Look | None:
    """Collect the runs of the first trial and their map; None where nothing ran in closed loop.

    Args:
        scenario: what the trials share.
        runs: of all trials.
    """
    if not runs:
        return None
    trial = runs[0].trial
    seen = {run.controller: run.seen for run in runs if run.trial == trial and not run.short}
    traces = {name: trace for name, trace in seen.items() if trace is not None}
    return Look(scenario, trial, traces, trial_map(scenario.robot.arm(), traces))


def baseline_and_best(traces: Mapping[str, Trace]) -> list[str]:
    """Return the baseline, and the controller with the largest mean mu: the first of those that are as good."""
    means = {name: float(trace.mu.mean()) for name, trace in traces.items() if name != BASELINE}
    best = [name for name, mean in means.items() if mean >= (1.0 - EQUAL) * max(means.values())]
    return [name for name in (BASELINE, *best[:1]) if name in traces]
