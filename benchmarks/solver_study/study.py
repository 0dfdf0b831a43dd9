"""The solver study: its request, its findings, and its parts in the order of their dependence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.solver_study import answers
from benchmarks.solver_study.answers import Limits
from benchmarks.solver_study.cases import trials
from benchmarks.solver_study.cells import Cell
from benchmarks.solver_study.closed_loop import Run
from benchmarks.solver_study.config import Config
from benchmarks.solver_study.settings import RECOMMENDED, SolverSetting, solver_settings
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import run as run_scenario
from moc_opt.solvers.registry import accepts
from moc_opt.study import Job, Kept, run

Advance = Callable[[str, float], None]
Summary = dict[str, dict[str, dict[str, Any]]]

NONLINEAR = "nlp-"


@dataclass(frozen=True)
class Study:
    """What is asked for.

    Attributes:
        config: of the comparison.
        names: of the solvers that can run here.
        out: folder of the results; finished jobs are kept in ``out/jobs``.
        advance: called with a few words, and the share of a batch of jobs, after each of them.
        show: called with parts of the summary as far as they have come.
        enter: called with the name of each part as it begins.
    """

    config: Config
    names: Sequence[str]
    out: Path
    advance: Advance
    show: Callable[[Mapping[str, Any]], None] = lambda _: None
    enter: Callable[[str], None] = lambda _: None

    @cached_property
    def kept(self) -> Kept:
        """Finished jobs, those of earlier runs among them."""
        return Kept(self.out / "jobs")

    def run(
        self, jobs: Sequence[Job], done: Callable[[Job, Any], None] = lambda job, result: None, **options: Any
    ) -> list[Any]:
        """Do jobs as `moc_opt.study.run` does, with this study's folder, workers and progress."""

        def step(job: Job, result: Any) -> None:
            self.advance(job.group, 1.0 / len(jobs))
            done(job, result)

        return run(jobs, kept=self.kept, workers=self.config.processes, done=step, **options)

    def ask(self, questions: Sequence[answers.Question], limits: Limits, *, warm: bool = True) -> list[answers.Part]:
        """Collect answers; see `answers.ask`."""
        return answers.ask(self.run, questions, limits, warm)

    def time(self, cells: Sequence[Cell], limits: Limits) -> list[answers.Part]:
        """Time the solvers of these cells on their sets; where not every problem was answered there are no times."""
        whole = [cell for cell in cells if cell.complete]
        measured = iter(answers.time(self.run, [(cell.setting, cell.data) for cell in whole], limits))
        return [next(measured) if cell.complete else answers.untimed(cell.data) for cell in cells]

    @cached_property
    def settings(self) -> list[SolverSetting]:
        """Every setting of every solver."""
        return solver_settings(self.names, self.config.settings)

    @property
    def recommended(self) -> list[SolverSetting]:
        """Each solver under the setting that we recommend."""
        return [setting for setting in self.settings if setting.name == RECOMMENDED]

    @property
    def growing(self) -> list[SolverSetting]:
        """Those whose times are taken for arms with more joints."""
        nonlinear = self.config.growth.nonlinear
        return [s for s in self.recommended if nonlinear or not s.solver.startswith(NONLINEAR)]

    @property
    def with_duals(self) -> list[str]:
        """Solvers that can be given six rows or five."""
        return [name for name in self.names if accepts(name, "rows")]

    @property
    def deadline_solvers(self) -> list[str]:
        """Those whose recorded times are replayed against a budget."""
        return [name for name in self.config.sweeps.deadline_solvers if name in self.names]


@dataclass
class Findings:
    """What was found: by one part of the study, or by all of them together.

    Attributes:
        summary: part -> solver or controller -> metric.
        rows: of rows.parquet, without those of `runs`.
        samples: of the figures.
        words: verdicts in words.
        runs: in closed loop.
        seconds: that each part took, of the wall clock.
        sequence: the recorded subproblems.
    """

    summary: Summary = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    samples: dict[str, Any] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)
    runs: list[Run] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    sequence: list[NullSpaceQP] = field(default_factory=list)

    def add(self, other: Findings) -> None:
        """Add the findings of one part."""
        self.summary |= other.summary
        self.rows += other.rows
        self.samples |= other.samples
        self.words |= other.words
        self.runs += other.runs


Part = Callable[[Study, Findings], Findings]
"""A part of the study: a function from earlier findings to its own."""


def record_sequence(config: Config) -> list[NullSpaceQP]:
    """Record the subproblems of a closed-loop run with ``exact``, one a tick."""
    (case,) = trials(config.scenario, [config.open_loop.task], config.seed, 1).values()
    duration_s = config.open_loop.ticks * config.scenario.plant.period_s
    trace = run_scenario(case.change(duration_s=duration_s, judge=False, bound_samples=0))
    return [NullSpaceQP.from_row(np.array(row)) for row in trace.subproblem]


def run_study(study: Study, parts: dict[str, Part]) -> Findings:
    """Run the parts that the configuration asks for, in the order given, and put their findings together."""
    found = Findings(sequence=record_sequence(study.config))
    for name, part in parts.items():
        if name in study.config.parts:
            begin = perf_counter()
            study.enter(name)
            found.add(part(study, found))
            study.show(found.summary)
            found.seconds[name] = round(perf_counter() - begin, 1)
    found.summary.setdefault("not_run", {})
    return found
