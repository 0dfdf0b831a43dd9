"""The paper's experiment in simulation, and which of its claims hold.

python -m benchmarks.paper [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

DCAC and MOC on three virtual tasks, with the paper's parameters and with tuned ones, with its own and with matched
gains, with every one of its solvers; then the verdict on each claim, the goals, which entry of the paper's Table I
decides, and what the starting swivel decides. Several trials run at a time, so no time is reported: that is what
``benchmarks.solvers`` is for.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration, runnable
from benchmarks.paper_experiment import page
from benchmarks.paper_experiment.procedure import ProcedureJob, ProcedureSettings, lost, perform
from benchmarks.paper_experiment.trials import (
    BASELINES,
    MATCHED,
    STREAM,
    Job,
    gain,
    lost_job,
    run_job,
    seeds,
    swivel_jobs,
    trials,
)
from benchmarks.paper_experiment.verdict import (
    Case,
    exchange_rows,
    goals,
    group_summary,
    phase_changes,
    swivel_summary,
    verdicts,
)
from moc_opt.control import ControlSettings
from moc_opt.errors import UnknownNameError
from moc_opt.inputs.settings import Name, Settings
from moc_opt.scenario import Scenario, Setup
from moc_opt.study import Kept, each
from moc_opt.vision.augmented_reality import pose_accuracy
from moc_opt.vision.board import board_task


class Group(Settings):
    """Trials with one set of parameters."""

    KIND: ClassVar[str] = "[groups.*]"
    about: str = ""
    control: dict[str, Any] = Field(default_factory=dict)
    task: dict[str, Any] = Field(default_factory=dict)
    start: dict[str, Any] = Field(default_factory=dict)


class Ablation(Settings):
    """Table I with entries exchanged; the first case is the table as printed, none leaves the ablation out."""

    KIND: ClassVar[str] = "[ablation]"
    group: str = Field("paper", description="whose parameters and trials")
    cases: dict[str, Case] = Field(default_factory=dict)


class Swivel(Settings):
    """The study of the starting swivel."""

    KIND: ClassVar[str] = "[swivel]"
    group: str = "tuned"
    task: str = "circle"
    starts: int = Field(15, ge=2)


class Config(Configuration):
    """benchmarks/configs/paper.toml."""

    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    trials: int = Field(5, ge=1)
    solvers: list[str] = Field(["exact", "rnn", "rnn-printed"], min_length=1)
    processes: int = Field(2, ge=1)
    best: str = "tuned"
    best_solver: str = "exact"
    elsewhere: str | None = Field(None, description="a group of other starts, of which the goals are asked too")
    groups: dict[Name, Group] = Field(default_factory=dict, min_length=1)
    ablation: Ablation = Ablation()
    swivel: Swivel = Swivel()
    procedure: ProcedureSettings = ProcedureSettings()
    scenario: Scenario = Scenario(judge=False)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a TOML file, and check it before anything moves.

        Raises:
            ScenarioError: no such file, no TOML, or a value out of range; names file and field.
            UnknownNameError: a task, solver, group or key that does not exist.
        """
        config = super().load(path)
        config.check()
        return config

    def check(self) -> None:
        """Check that every name exists and every kind of trial can be set up.

        Raises:
            MocOptError: the first thing that is wrong.
        """
        named = (self.best, self.swivel.group, self.ablation.group if self.ablation.cases else None, self.elsewhere)
        for group in named:
            if group is not None and group not in self.groups:
                raise UnknownNameError("group", group, self.groups)
        if self.best_solver not in self.solvers:
            raise UnknownNameError("best_solver", self.best_solver, self.solvers)
        board_task(self.swivel.task)
        runnable([*self.solvers, *(case.controller for case in self.ablation.cases.values())], *BASELINES)
        for name in self.groups:
            for _, trial in trials(self.base(name), self.tasks, seeds(self.seed, STREAM, len(self.tasks))):
                Setup(trial)
        for case in self.ablation.cases.values():
            Setup(self.changed(case))

    def quick(self) -> Self:
        """Return the same experiment on less data: for a first look and for the tests."""
        cases = dict(islice(self.ablation.cases.items(), 2))
        return self.model_copy(update={
            "tasks": self.tasks[:1], "trials": 2, "swivel": self.swivel.model_copy(update={"starts": 3}),
            "procedure": self.procedure.model_copy(update={"poses": 20, "film": False}),
            "ablation": self.ablation.model_copy(update={"cases": cases}),
        })  # fmt: skip

    def base(self, group: str) -> Scenario:
        """Return the scenario that a group's trials share."""
        table = self.groups[group]
        return self.scenario.change(control=table.control, task=table.task, start=table.start)

    def same_path(self, group: str) -> bool:
        """Tell whether a group's trials follow the paths of the best group, at the same time."""
        mine, best = self.groups[group], self.groups[self.best]
        return (mine.task, mine.start) == (best.task, best.start)

    def changed(self, case: Case) -> Scenario:
        """Return the scenario that the trials of a case of the ablation share.

        Raises:
            UnknownNameError: a setting that does not exist.
            MocOptError: a value out of range.
        """
        for name in case.without:
            if name not in ControlSettings.model_fields:
                raise UnknownNameError("[ablation.cases.*] without", name, ControlSettings.model_fields)
        defaults = {name: getattr(ControlSettings(), name) for name in case.without}
        return self.base(self.ablation.group).change(control={**case.control, **defaults}, bound_samples=0)

    def jobs(self) -> list[Job]:
        """Return every group on every trial; the trials are the same for all groups."""
        drawn = seeds(self.seed, STREAM, self.trials * len(self.tasks))
        return [
            # Which trial is looked at is known only when all have run.
            Job(group, task, trial, (*BASELINES, *self.solvers), keep_traces=self.same_path(group))
            for group in self.groups
            for task, trial in trials(self.base(group).change(best_courses=True), self.tasks, drawn)
        ]

    def ablation_jobs(self) -> list[Job]:
        """Return every case of the ablation on the same trials; ``group`` is the case."""
        drawn = seeds(self.seed, STREAM, self.trials * len(self.tasks))
        return [
            Job(name, task, trial, (MATCHED, case.controller), brief=True)
            for name, case in self.ablation.cases.items()
            for task, trial in trials(self.changed(case), self.tasks, drawn)
        ]

    def swivel_jobs(self) -> list[tuple[dict[str, Any], Job]]:
        """Return one trial from every place of its self-motion, each with what tells its row from others."""
        asked = self.swivel
        [(_, trial)] = trials(self.base(asked.group), [asked.task], seeds(self.seed, STREAM, 1))
        return swivel_jobs(trial, asked.task, asked.starts, self.best_solver)

    def procedures(self, out: Path) -> list[ProcedureJob]:
        """Return the whole procedure, once a task, under the best MOC; the first is filmed to a file in ``out``."""
        base = self.base(self.best).change(solver={"name": self.best_solver})
        film = out / "film.webm" if self.procedure.film else None
        return [
            ProcedureJob(self.procedure, base.change(seed=seed), task, film if task == self.tasks[0] else None)
            for task, seed in zip(self.tasks, seeds(self.seed, STREAM, len(self.tasks)), strict=True)
        ]


def experiment(given: Namespace) -> cli.Results:
    """Run every part; the replay is written here, as the page refers to it."""
    config, out = Config.chosen(given, "paper"), given.out
    out.mkdir(parents=True, exist_ok=True)
    kept, robot = Kept(out / "jobs"), config.scenario.robot.arm()
    jobs, exchanges, places, tasks = (
        config.jobs(), config.ablation_jobs(), config.swivel_jobs(), config.procedures(out)
    )  # fmt: skip
    with cli.steps("trials", len(jobs) + len(exchanges) + len(places) + len(tasks) + 1) as step:
        many = partial(each, kept=kept, workers=config.processes, step=step)
        outcomes = many(run_job, jobs, failed=lost_job)
        exchanged = many(run_job, exchanges, failed=lost_job)
        started = many(run_job, [job for _, job in places], failed=lost_job)
        swivel = [{**row, **gain(outcome)} for (row, _), outcome in zip(places, started, strict=True)]
        procedure = many(perform, tasks, failed=lost)
        looks = page.looks(robot, outcomes, config.best, config.best_solver)
        step()

    found, of_cases = ([m for one in part for m in one.measurements] for part in (outcomes, exchanged))
    broken, cases_broken = ([row for one in part for row in one.broken] for part in (outcomes, exchanged))
    best = (config.best, config.best_solver)
    each_moc = [(group, solver) for group in config.groups for solver in config.solvers]
    summary: dict[str, Any] = {
        **{group: group_summary(found, broken, group, (*BASELINES, *config.solvers)) for group in config.groups},
        "verdict": [row for moc in each_moc for row in verdicts(found, *moc)],
        "phases": [row for moc in each_moc for row in phase_changes(found, *moc)],
        "goals": goals(found, *best),
        "ablation": exchange_rows(config.ablation.cases, of_cases),
        "swivel": swivel_summary(swivel),
        "procedure": {row["task"]: {k: v for k, v in row.items() if k not in ("part", "task")} for row in procedure},
        "board_pictures": dict(pose_accuracy(
            config.procedure.camera, config.procedure.board, poses=config.procedure.poses, seed=config.seed
        )),
        "courses": [row for look in looks for row in look.rows()],
    }  # fmt: skip
    if config.elsewhere is not None:
        summary["goals_elsewhere"] = goals(found, config.elsewhere, config.best_solver)
    rows = [
        *(m.row("trials") for m in found), *(m.row("ablation") for m in of_cases), *broken,
        *({**row, "part": "ablation broke off"} for row in cases_broken), *swivel, *procedure,
    ]  # fmt: skip
    timing = f"none: {config.processes} processes at a time shared the machine"
    environment = config.environment(given, timing=timing, jobs_of_an_earlier_run=kept.reused)
    groups = {name: group.about or name for name, group in config.groups.items()}
    boxes = {group: page.box_figures(outcomes, group, config.tasks) for group in groups}
    start = page.swivel_figure(swivel)
    first = page.answer(summary, list(groups), {**boxes.get(page.PRINTED, {}), "swivel": start})
    made = page.page(summary, groups, best, boxes, looks, robot, out, environment, first)
    return cli.Results(summary, environment, rows=rows, page=made, files=["replay.html"], answer=first)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; see `cli.run` for the exit status."""
    options = cli.parser("paper", "The paper's experiment, and which of its claims hold.")
    return cli.run(options, experiment, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
