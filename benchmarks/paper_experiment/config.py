"""What the paper's experiment is told: benchmarks/configs/paper.toml, validated."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import Field

from benchmarks.common.config import Configuration, runnable
from benchmarks.paper_experiment.ablation import Ablation, AblationJob, changed
from benchmarks.paper_experiment.ablation import jobs as ablation_jobs
from benchmarks.paper_experiment.procedure import ProcedureJob, ProcedureSettings
from benchmarks.paper_experiment.trials import BASELINES, Job, seeds, trials
from moc_opt.errors import UnknownNameError
from moc_opt.inputs.settings import Name, Settings
from moc_opt.model.robot_model import load_robot
from moc_opt.scenario import Scenario, Setup, make_solver
from moc_opt.vision.board import board_task

STREAM = 0  # of seeds; the search has its own


class Group(Settings):
    """Trials with one set of parameters."""

    KIND: ClassVar[str] = "[groups.*]"
    about: str = ""
    control: dict[str, Any] = Field(default_factory=dict)
    task: dict[str, Any] = Field(default_factory=dict)
    start: dict[str, Any] = Field(default_factory=dict)


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
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict, description="per solver")
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
        """Read a TOML file.

        Raises:
            ScenarioError: no such file, no TOML, or a value out of range; names file and field.
            UnknownNameError: a task, solver, group or key that does not exist.
        """
        config = super().load(path)
        config.check()
        return config

    def check(self) -> None:
        """Check that every name exists and every kind of trial can be set up: found out before anything moves.

        Raises:
            MocOptError: the first thing that is wrong.
        """
        named = (self.best, self.swivel.group, self.ablation.group if self.ablation.cases else None, self.elsewhere)
        for group in named:
            if group is not None and group not in self.groups:
                raise UnknownNameError("group", group, self.groups)
        if self.best_solver not in self.solvers:
            raise UnknownNameError("best_solver", self.best_solver, self.solvers)
        for task in (*self.tasks, self.swivel.task):
            board_task(task)
        runnable(self.solvers)
        robot = load_robot(self.scenario.robot.name)
        for name in self.solvers:
            make_solver(name, robot, **self.settings.get(name, {}))
        for name in self.groups:
            for _, trial in trials(self.base(name), self.tasks, seeds(self.seed, STREAM, len(self.tasks))):
                Setup(trial)
        for case in self.ablation.cases.values():
            if case.controller not in (*self.solvers, *BASELINES):
                raise UnknownNameError("controller", case.controller, (*self.solvers, *BASELINES))
            Setup(changed(self.base(self.ablation.group), case))

    def quick(self) -> Self:
        """Return the same experiment on less data: for a first look and for the tests."""
        less = {
            "tasks": self.tasks[:1], "trials": 2, "swivel": self.swivel.model_copy(update={"starts": 3}),
            "procedure": self.procedure.model_copy(update={"poses": 20, "film": False}),
            "ablation": self.ablation.quick(),
        }  # fmt: skip
        return self.model_copy(update=less)

    def base(self, group: str) -> Scenario:
        """Return the scenario that a group's trials share."""
        table = self.groups[group]
        return self.scenario.change(control=table.control, task=table.task, start=table.start)

    def same_path(self, group: str) -> bool:
        """Tell whether a group's trials follow the paths of the best group, at the same time."""
        mine, best = self.groups[group], self.groups[self.best]
        return (mine.task, mine.start) == (best.task, best.start)

    def procedures(self, out: Path) -> list[ProcedureJob]:
        """Return the whole procedure, once a task, under the best MOC; the first is filmed to a file in ``out``."""
        base = self.base(self.best).change(solver={"name": self.best_solver})
        jobs = []
        for i, (task, seed) in enumerate(zip(self.tasks, seeds(self.seed, STREAM, len(self.tasks)), strict=True)):
            film = out / "film.webm" if i == 0 and self.procedure.film else None
            jobs.append(ProcedureJob(self.procedure, base.change(seed=seed), task, film))
        return jobs

    def ablation_jobs(self) -> list[AblationJob]:
        """Return every case of the ablation on every trial of every draw; none without cases."""
        if not self.ablation.cases:
            return []
        base = self.base(self.ablation.group)
        return ablation_jobs(self.ablation, base, self.tasks, self.trials, self.seed, STREAM)

    def jobs(self) -> list[Job]:
        """Return every group on every trial; the trials are the same for all groups."""
        drawn = seeds(self.seed, STREAM, self.trials * len(self.tasks))
        controllers = (*BASELINES, *self.solvers)
        jobs = []
        for group in self.groups:
            for i, (task, trial) in enumerate(trials(self.base(group).change(best_courses=True), self.tasks, drawn)):
                # Which trial is looked at is known only when all have run.
                keep = i == 0 or self.same_path(group)
                jobs.append(Job(group, task, trial, controllers, self.settings, keep_traces=keep))
        return jobs
