"""Every arm of the package under every controller on the paper's tasks: the findings that hold on all, and the others.

python -m benchmarks.robots [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

Starts are drawn from the whole workspace of each arm by the rules of `moc_opt.vision.preflight.random_start`.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Self

from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration
from benchmarks.paper_experiment.trials import seeds, trials
from benchmarks.robots_study.page import answer, report
from benchmarks.robots_study.runs import Job, lost_job, run_job
from benchmarks.robots_study.verdict import summarise
from moc_opt.scenario import Scenario
from moc_opt.study import Kept, each

STREAM = 8
"""Of the seeds: no trial of this benchmark is one of another."""


class Config(Configuration):
    """benchmarks/configs/robots.toml."""

    robots: list[str] = Field(["lwr4", "iiwa14", "panda", "gen3", "xarm7", "lwr4_rail"], min_length=1)
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    starts: int = Field(5, ge=1, description="random starts per task and robot")
    solvers: list[str] = Field(["exact", "osqp", "proxqp", "rnn", "nlp-sqp"], min_length=1)
    processes: int = Field(2, ge=1)
    scenario: Scenario = Scenario(start={"pose": "random"}, bound_samples=10)

    def quick(self) -> Self:
        """Return the same on less data."""
        return self.model_copy(update={"tasks": self.tasks[:1], "starts": 2, "solvers": self.solvers[:2]})

    def jobs(self) -> list[Job]:
        """Return one trial each, every one with a seed of its own."""
        count, found = self.starts * len(self.tasks), []
        drawn = seeds(self.seed, STREAM, count * len(self.robots))
        for k, name in enumerate(self.robots):
            base, own = self.scenario.change(robot={"name": name}), drawn[k * count : (k + 1) * count]
            found += [Job(task, trial, tuple(self.solvers)) for task, trial in trials(base, self.tasks, own)]
        return found


def study(given: Namespace) -> cli.Results:
    """Run every trial of every arm."""
    config = Config.chosen(given, "robots")
    jobs, kept = config.jobs(), Kept(given.out / "jobs")
    with cli.steps("trials", len(jobs)) as step:
        done = each(run_job, jobs, kept=kept, workers=config.processes, step=step, failed=lost_job)
    rows = [row for found in done for row in found]
    summary, environment = summarise(rows), config.environment(given, jobs_of_an_earlier_run=kept.reused)
    first = answer(summary)
    return cli.Results(summary, environment, rows, report(summary, rows, first, environment), answer=first)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    return cli.run(cli.parser("robots", "What holds on every arm."), study, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
