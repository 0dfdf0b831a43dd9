"""Every arm of the package under every controller on the paper's tasks: what holds on all of them, and what does not.

python -m benchmarks.robots [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

Starts are drawn from the whole workspace of each arm by the rules of `moc_opt.procedure.preflight.random_start`.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Self

from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration
from benchmarks.common.crew import run_parallel
from benchmarks.paper_experiment.trials import seeds, trials
from benchmarks.robots_study.first_screen import answer
from benchmarks.robots_study.parts import Job, run_job
from benchmarks.robots_study.report import report
from benchmarks.robots_study.tables import summarise
from moc_opt.scenario import Scenario

STREAM = 8
"""Of the seeds: no trial of this benchmark is one of another."""


class Config(Configuration):
    """benchmarks/configs/robots.toml."""

    robots: list[str] = Field(["lwr4", "iiwa14", "panda", "gen3", "xarm7", "lwr4_rail"], min_length=1)
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    starts: int = Field(5, ge=1, description="random starts per task and robot")
    solvers: list[str] = Field(["exact", "osqp", "proxqp", "rnn", "nlp-sqp"], min_length=1)
    processes: int = Field(2, ge=1)
    scenario: Scenario = Scenario(start={"pose": "random"}, bound_samples=10)  # type: ignore[arg-type]

    def quick(self) -> Self:
        """Return the same on less data."""
        return self.model_copy(update={"tasks": self.tasks[:1], "starts": 2, "solvers": self.solvers[:2]})

    def jobs(self) -> list[Job]:
        """Return one trial each."""
        drawn = seeds(self.seed, STREAM, self.starts * len(self.tasks))
        return [
            Job(task, trial, tuple(self.solvers))
            for name in self.robots
            for task, trial in trials(self.scenario.change(robot={"name": name}), self.tasks, drawn)
        ]


def study(given: Namespace) -> cli.Results:
    """Run every trial of every arm."""
    config = Config.chosen(given, "robots")
    jobs = config.jobs()
    with cli.steps("trials", len(jobs)) as step:
        rows = [row for found in run_parallel(run_job, jobs, config.processes, step) for row in found]
    summary, environment = summarise(rows), config.environment(given)
    first = answer(summary)
    return cli.Results(summary, environment, rows, report(summary, rows, first, environment), answer=first)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    return cli.run(cli.parser("robots", "What holds on every arm."), study, arguments)


if __name__ == "__main__":
    sys.exit(main())
