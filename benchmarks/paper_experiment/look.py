"""Which trials of the paper's experiment are looked at, and the section of the page that shows them.

One trial a task, of the group that the goals are asked of: the one in which the best MOC gained neither most nor least,
but what the middle one of the task's trials gained. So no controller is shown on the trial that suits it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from benchmarks.common.look import add_replay, trial_map
from benchmarks.paper_experiment.config import Config
from benchmarks.paper_experiment.figures import titles
from benchmarks.paper_experiment.trials import BASELINES, MATCHED, Outcome
from moc_opt.figures.style import Styles
from moc_opt.redundancy.manipulability_map import SwivelMap
from moc_opt.redundancy.map_analysis import read_trajectory
from moc_opt.report.map_figure import map_figure
from moc_opt.report.map_page import add_map, lines
from moc_opt.report.page import Page
from moc_opt.trace.trace import Trace


@dataclass(frozen=True)
class Look:
    """One trial: its name, the runs by their titles, and their map or the reason why there is none."""

    trial: str
    gain_percent: float
    """In mean mu, of the best MOC over DCAC with the same gains."""
    of: int
    """Trials of that task that it was chosen from."""
    traces: Mapping[str, Trace]
    found: SwivelMap | str

    def choice(self) -> str:
        """Return which trial it is, in a few words."""
        return f"{self.trial}: {self.gain_percent:+.1f} %, of {self.of} trials"


def chosen(outcomes: Sequence[Outcome], group: str, solver: str) -> dict[str, tuple[Outcome, float, int]]:
    """Map task to the trial with the middle gain, that gain, and of how many; of an even number the lower middle."""
    gains: dict[str, list[tuple[float, int]]] = {}
    for place, outcome in enumerate(outcomes):
        for m in outcome.measurements:
            if (m.group, m.controller, m.phase) == (group, solver, "whole") and outcome.traces:
                gain = m.metrics.get("mu_gain_percent")
                if gain is not None:
                    gains.setdefault(m.task, []).append((gain, place))
    found = {}
    for task, known in gains.items():
        gain, place = sorted(known)[(len(known) - 1) // 2]
        found[task] = (outcomes[place], gain, len(known))
    return found


def looks(config: Config, outcomes: Sequence[Outcome]) -> dict[str, Look]:
    """Map task to what is to be seen of it."""
    robot, found = config.scenario.robot.arm(), {}
    for task, (outcome, gain, of) in chosen(outcomes, config.best, config.best_solver).items():
        names = titles(list(outcome.traces))
        traces = {names[name]: trace for name, trace in outcome.traces.items()}
        trial = outcome.measurements[0].trial
        traces |= elsewhere(config, outcomes, trial)
        found[task] = Look(trial, gain, of, traces, trial_map(robot, traces))
    return found


def elsewhere(config: Config, outcomes: Sequence[Outcome], trial: str) -> dict[str, Trace]:
    """Find the best MOC on the same trial with the parameters of the other groups that leave the path as it is."""
    (best,) = titles([config.best_solver]).values()
    return {
        f"{best}, group {m.group}": outcome.traces[config.best_solver]
        for outcome in outcomes
        for m in outcome.measurements[:1]
        if m.trial == trial and config.same_path(m.group) and m.group != config.best
        and config.best_solver in outcome.traces
    }  # fmt: skip


def rows(found: Mapping[str, Look]) -> list[dict[str, Any]]:
    """Return what each trajectory amounts to: one row a task and controller."""
    return [
        {"task": task, "trial": look.trial, **asdict(read_trajectory(look.found, name))}
        for task, look in found.items()
        if not isinstance(look.found, str)
        for name in look.found.trajectories
    ]


def map_figures(found: Mapping[str, Look]) -> dict[str, go.Figure]:
    """Draw each map by its file's name, as the page shows it."""
    return {
        f"map-{task}": map_figure(look.found, Styles(look.traces), titles=lines(look.found))
        for task, look in found.items()
        if not isinstance(look.found, str)
    }


def add_section(page: Page, found: Mapping[str, Look], folder: Path, config: Config) -> None:
    """Add the maps, and the replay of the first trial in ``folder``."""
    if not found:
        return
    (best,) = titles([config.best_solver]).values()
    page.section("Where the elbow goes")
    page.text(
        f"One trial of each task, from the group {config.best}: the one in which {best} gained the middle of what it "
        "gained over DCAC with the same gains in all trials of that task, so that no controller is shown on the trial "
        f"that suits it ({'; '.join(map(Look.choice, found.values()))}). All controllers start from the same pose, on "
        f"the same plant; where a group changes parameters alone, {best} is shown with these too."
    )
    for task, look in found.items():
        if isinstance(look.found, str):
            page.text(f"{task}: there is no map: {look.found}")
        else:
            styles = Styles(look.traces)
            add_map(page, look.found, name=f"map-{task}", what=f"trial {look.trial}", styles=styles)
    look = next(iter(found.values()))
    pair = {name: look.traces[name] for name in (BASELINES[MATCHED], best) if name in look.traces}
    add_replay(
        page, folder, config.scenario.robot.arm(), pair, f"Trial {look.trial}: {' and '.join(pair)}",
        Styles(look.traces),
    )  # fmt: skip
