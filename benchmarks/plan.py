"""How much manipulability a path holds, and how much of it each third level reaches in the loop.

python -m benchmarks.plan [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json] [--page]

Starts are drawn by the rules of `moc_opt.procedure.preflight.random_start`. The map's largest mu is searched for by
inverse kinematics from random starts, the nonlinear program is begun elsewhere, the grid is halved, the map is timed.
A trial that is done is kept in DIR/jobs: the same command goes on where it was broken off, at the same commit.
--page also writes the tables into docs/planning.md.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Self, get_args

from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration
from benchmarks.common.crew import run_parallel
from benchmarks.common.markdown import write_section
from benchmarks.common.output import default_config
from benchmarks.common.store import Part, Store
from benchmarks.paper_experiment.trials import seeds, trials
from benchmarks.planning.first_screen import answer
from benchmarks.planning.page import COMMANDS, PAGE, page_text
from benchmarks.planning.parts import Job, run_job
from benchmarks.planning.tables import report, summarise
from moc_opt.control import ControlSettings
from moc_opt.errors import MocOptError
from moc_opt.planning.spherical import spherical
from moc_opt.scenario import Scenario

THIRD_LEVELS: tuple[str, ...] = get_args(ControlSettings.model_fields["third_level"].annotation)
LOOPS: dict[str, dict[str, Any]] = {level: {"third_level": level} for level in THIRD_LEVELS} | {
    # What the observer's gain under a course is worth to the climb, beside it: tip and RCM error come of its lag.
    "local, observer of the courses": {
        "observer_gain_per_s": ControlSettings.model_fields["course_observer_gain_per_s"].default
    },
}
STREAM = 7
"""Of the seeds: no trial of this benchmark is one of another."""


class Config(Configuration):
    """benchmarks/configs/plan.toml."""

    robots: list[str] = Field(["lwr4", "iiwa14", "panda"], min_length=1)
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    seed: int = Field(4000, ge=0, description="not one of those that the limits of courses were chosen on")
    poses: int = Field(20, ge=1, description="random starts per task and robot")
    loops: dict[str, dict[str, Any]] = Field(LOOPS, description="closed loops: name -> [control]")
    halvings: int = Field(3, ge=0, description="starts at which the grid is halved")
    processes: int = Field(2, ge=1)
    map_points: int = Field(3, ge=0)
    random_starts: int = Field(1000, ge=1)
    restart_poses: int = Field(2, ge=0)
    restarts: int = Field(100, ge=1)
    scenario: Scenario = Scenario(start={"pose": "random"})  # type: ignore[arg-type]

    def quick(self) -> Self:
        """Return the same on less data."""
        less = {"robots": self.robots[:2], "tasks": self.tasks[:1], "poses": 2, "map_points": 1, "random_starts": 30}
        return self.model_copy(update=less | {"restart_poses": 1, "restarts": 3, "halvings": 1})

    def jobs(self) -> list[Job]:
        """Return every part on every trial that it is for; the timed one first, before other processes are busy."""
        found: list[Job] = []
        for name in self.robots:
            base = self.scenario.change(robot={"name": name})
            drawn = trials(base, self.tasks, seeds(self.seed, STREAM, self.poses * len(self.tasks)))
            found += [Job("courses", name, *trial, loops=self.loops) for trial in drawn]
            spread = drawn[:: max(1, len(drawn) // max(self.map_points, self.restart_poses, self.halvings, 1))]
            found += [Job("halving", name, *trial) for trial in spread[: self.halvings]]
            if spherical(base.robot.arm()) is None:
                continue  # the other parts are about the closed form
            found.append(Job("map", name, *drawn[0]))
            found += [Job("closed_form", name, *trial, self.random_starts) for trial in spread[: self.map_points]]
            found += [Job("restarts", name, *trial, self.restarts) for trial in spread[: self.restart_poses]]
        return found


def study(given: Namespace) -> cli.Results:
    """Plan every trial; the timed part first, before other processes are busy. ``--page`` writes docs/planning.md."""
    config = Config.chosen(given, "plan")
    section = section_of(config) if given.page else ""
    jobs = config.jobs()
    environment = config.environment(given)
    work = partial(kept_rows, given.out / "jobs", str(environment["commit"]))
    with cli.steps("plans", len(jobs)) as step:
        each = run_parallel(work, [job for job in jobs if job.part == "map"], 1, step)
        each += run_parallel(work, [job for job in jobs if job.part != "map"], config.processes, step)
    rows = [row for found in each for row in found]
    summary = summarise(rows)
    if section:
        write_section(PAGE, section, page_text(section, summary, environment))
    first = answer(summary, rows)
    return cli.Results(summary, environment, rows, report(summary, rows, first, environment), answer=first)


def section_of(config: Config) -> str:
    """Return the section of docs/planning.md that a configuration writes.

    Raises:
        MocOptError: the page shows no figures of this one.
    """
    for name in COMMANDS:
        if config == Config.load(default_config(name)):
            return name
    raise MocOptError(f"--page: the page shows runs of {' and '.join(map(repr, COMMANDS.values()))}: run one of these")


def kept_rows(folder: Path, commit: str, job: Job) -> list[dict[str, Any]]:
    """Return the rows of a job: from the folder, if it was done before at this commit, or else worked out."""
    store = Store(folder)
    key = store.key(
        commit=commit, part=job.part, robot=job.robot, trial=job.trial.model_dump(mode="json"), count=job.count,
        loops=dict(job.loops),
    )  # fmt: skip
    part = store.get(key)
    found: list[dict[str, Any]] = (part or store.put(key, Part({"rows": run_job(job)}, {}))).values["rows"]
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("plan", "How much manipulability a path holds.")
    options.add_argument("--page", action="store_true", help=f"write the tables into {PAGE.parent.name}/{PAGE.name}")
    return cli.run(options, study, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
