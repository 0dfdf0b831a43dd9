"""How much manipulability a path holds: the best course from each start and over all, its bound, and a local climb.

python -m benchmarks.plan [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

Starts are drawn by the rules of `moc_opt.procedure.preflight.random_start`. The map's largest mu is searched for by
inverse kinematics from random starts, the nonlinear program is begun elsewhere, the grid is halved, the map is timed.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Self

from pydantic import Field

from benchmarks import cli
from benchmarks.config import Configuration
from benchmarks.crew import run_parallel
from benchmarks.paper_experiment.trials import seeds, trials
from benchmarks.planning.parts import Job, run_job
from benchmarks.planning.tables import report, summarise, tables
from moc_opt.scenario import Scenario

STREAM = 7
"""Of the seeds: no trial of this benchmark is one of another."""


class Config(Configuration):
    """benchmarks/configs/plan.toml."""

    robots: list[str] = Field(["lwr4", "iiwa14"], min_length=1)
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    poses: int = Field(20, ge=1, description="random starts per task and robot")
    processes: int = Field(2, ge=1)
    map_points: int = Field(3, ge=0)
    random_starts: int = Field(1000, ge=1)
    restart_poses: int = Field(2, ge=0)
    restarts: int = Field(100, ge=1)
    scenario: Scenario = Scenario(start={"pose": "random"})  # type: ignore[arg-type]

    def quick(self) -> Self:
        """The same on less data."""
        less = {"tasks": self.tasks[:1], "poses": 2, "map_points": 1, "random_starts": 30, "restart_poses": 1}
        return self.model_copy(update=less | {"restarts": 3})

    def jobs(self) -> list[Job]:
        """Every part on every trial that it is for; the timed one first, before other processes are busy."""
        found: list[Job] = []
        for name in self.robots:
            base = self.scenario.change(robot={"name": name})
            drawn = trials(base, self.tasks, seeds(self.seed, STREAM, self.poses * len(self.tasks)))
            found.append(Job("map", name, *drawn[0]))
            found += [Job("courses", name, *trial) for trial in drawn]
            spread = drawn[:: max(1, len(drawn) // max(self.map_points, self.restart_poses, 1))]
            found += [Job("closed_form", name, *trial, self.random_starts) for trial in spread[: self.map_points]]
            found += [Job("restarts", name, *trial, self.restarts) for trial in spread[: self.restart_poses]]
        return found


def study(given: Namespace) -> cli.Results:
    """Plan every trial; the timed part first, before other processes are busy."""
    config = Config.chosen(given, "plan")
    jobs = config.jobs()
    with cli.steps("plans", len(jobs)) as step:
        rows = run_parallel(run_job, [job for job in jobs if job.part == "map"], 1, step)
        rows += run_parallel(run_job, [job for job in jobs if job.part != "map"], config.processes, step)
    summary, environment = summarise(rows), config.environment(given)
    return cli.Results(summary, environment, rows, report(summary, rows, environment), tables(summary))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    return cli.run(cli.parser("plan", "How much manipulability a path holds."), study, arguments)


if __name__ == "__main__":
    sys.exit(main())
