"""How much manipulability a path holds, and how much of it each third level reaches in the loop.

python -m benchmarks.plan [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json] [--page]

Starts are drawn by the rules of `moc_opt.vision.preflight.random_start`. The map's largest mu is searched for by
inverse kinematics from random starts, the nonlinear program is begun elsewhere, and the grid is halved.
--page also writes the tables into docs/planning.md.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Any, Self, get_args

from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration
from benchmarks.common.markdown import write_section
from benchmarks.common.output import default_config
from benchmarks.paper_experiment.trials import seeds, trials
from benchmarks.planning.page import COMMANDS, PAGE, answer, page_text, report
from benchmarks.planning.runs import Job, lost_job, run_job
from benchmarks.planning.verdict import summarise
from moc_opt.control import ControlSettings
from moc_opt.errors import MocOptError
from moc_opt.planning.pose_map import closed_form
from moc_opt.scenario import Scenario
from moc_opt.study import Kept, each

CONTROL = ControlSettings.model_fields
LOOPS: dict[str, dict[str, Any]] = {
    **{level: {"third_level": level} for level in get_args(CONTROL["third_level"].annotation)},
    # What the observer's gain under a course is worth to the climb, beside it: tip and RCM error come of its lag.
    "local, observer of the courses": {"observer_gain_per_s": CONTROL["course_observer_gain_per_s"].default},
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
    scenario: Scenario = Scenario(start={"pose": "random"})

    def quick(self) -> Self:
        """Return the same on less data."""
        less = {"robots": self.robots[:2], "tasks": self.tasks[:1], "poses": 2, "map_points": 1, "random_starts": 30}
        return self.model_copy(update=less | {"restart_poses": 1, "restarts": 3, "halvings": 1})

    def jobs(self) -> list[Job]:
        """Return every part on every trial that it is for; the checks of map and program are of closed forms."""
        found: list[Job] = []
        count = self.poses * len(self.tasks)
        own = seeds(self.seed, STREAM, count * len(self.robots))
        for k, name in enumerate(self.robots):
            base = self.scenario.change(robot={"name": name})
            drawn = trials(base, self.tasks, own[k * count : (k + 1) * count])
            some = drawn[:: max(1, len(drawn) // max(self.map_points, self.restart_poses, self.halvings, 1))]
            found += [Job("courses", name, *trial, loops=self.loops) for trial in drawn]
            found += [Job("halving", name, *trial) for trial in some[: self.halvings]]
            if closed_form(base.robot.arm()) is not None:
                found += [Job("closed_form", name, *one, self.random_starts) for one in some[: self.map_points]]
                found += [Job("restarts", name, *one, self.restarts) for one in some[: self.restart_poses]]
        return found


def study(given: Namespace) -> cli.Results:
    """Plan every trial; ``--page`` writes docs/planning.md."""
    config = Config.chosen(given, "plan")
    section = section_of(config) if given.page else ""
    jobs, environment, kept = config.jobs(), config.environment(given), Kept(given.out / "jobs")
    with cli.steps("plans", len(jobs)) as step:
        done = each(run_job, jobs, kept=kept, workers=config.processes, step=step, failed=lost_job)
    rows = [row for found in done for row in found]
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("plan", "How much manipulability a path holds.")
    options.add_argument("--page", action="store_true", help=f"write the tables into {PAGE.parent.name}/{PAGE.name}")
    return cli.run(options, study, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
