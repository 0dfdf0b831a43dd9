"""The parts of the planning benchmark, one function a part; each returns rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from moc_opt import scenario
from moc_opt.errors import MocOptError, RobotError
from moc_opt.planning.course import Limits, make_course
from moc_opt.planning.plan import best_course
from moc_opt.planning.pose_map import largest_mu, map_of
from moc_opt.planning.program import refine
from moc_opt.planning.search import Value
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots.inverse_kinematics import solve_pose
from moc_opt.scenario import Scenario
from moc_opt.scenario.planned import plan
from moc_opt.study import Failed
from moc_opt.study.trials import placed
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import summarize

ERRORS = ("tip_error_model_mean_mm", "rcm_error_model_mean_mm")
"""By the robot's own kinematics, from the registered trocar."""


@dataclass(frozen=True)
class Job:
    """One part on one trial."""

    part: str
    robot: str
    task: str
    trial: Scenario
    count: int = 0
    """Random starts."""
    loops: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Name of a closed loop -> what it changes in [control]."""

    def row(self) -> dict[str, Any]:
        """Return what tells its rows from others."""
        return {"part": self.part, "robot": self.robot, "task": self.task, "trial": self.trial.name,
                "seed": self.trial.seed, "error": ""}  # fmt: skip


def run_job(job: Job) -> list[dict[str, Any]]:
    """Return one row, of "courses" one more for each closed loop; ``error`` says what went wrong with the trial."""
    parts: dict[str, Callable[[Job], list[dict[str, Any]]]] = {
        "courses": courses, "halving": halving, "closed_form": random_starts, "restarts": restarts,
    }  # fmt: skip
    try:
        rows = parts[job.part](job)
    except MocOptError as error:
        rows = [{"error": f"{type(error).__name__}: {error}"}]
    return [job.row() | row for row in rows]


def lost_job(job: Job, failed: Failed) -> list[dict[str, Any]]:
    """Return the row of a trial that gave no result."""
    return [job.row() | {"error": str(failed)}]


def courses(job: Job) -> list[dict[str, Any]]:
    """Return every course from one start with their bounds, and what closed loops make of the best one."""
    trial = placed(job.trial)
    found = plan(trial)
    row: dict[str, Any] = {
        "executable": found.executable, "blocked": "" if found.blocked is None else found.blocked.reason,
        "climbed_whole": found.climbed_whole, "bound_from_start": found.bound_from_start, "bound": found.bound,
        "map_s": found.map_s, "search_s": found.search_s, "refine_s": found.refine_s,
    }  # fmt: skip
    mine, best = found.from_start, found.best
    if found.climbed_whole:
        row["climbed"] = found.climbed.mu_mean
    if best is not None:
        row |= {"best": best.mu_mean, "best_certified": best.certified, "best_violation": best.violation}
    if mine is None or best is None:
        return [row]
    row |= {"from_start": mine.mu_mean, "certified": mine.certified, "violation": mine.violation,
            "start_loss_percent": 100.0 * (1.0 - mine.mu_mean / best.mu_mean)}  # fmt: skip
    for name, bound, course in (("", found.bound_from_start, mine), ("_best", found.bound, best)):
        if np.isfinite(bound):
            row[f"bound_gap{name}_percent"] = 100.0 * (bound / course.mu_mean - 1.0)
    if found.climbed_whole:
        row["climb_gap_percent"] = 100.0 * (1.0 - found.climbed.mu_mean / mine.mu_mean)
    return [row, *(loop(trial, name, change, mine.mu_mean, best.mu_mean) for name, change in job.loops.items())]


def loop(trial: Scenario, name: str, change: Mapping[str, Any], mine: float, best: float) -> dict[str, Any]:
    """Return one run of the trial in its plant, against the mean mu of the best courses."""
    row: dict[str, Any] = {"part": "loop", "loop": name}
    try:
        trace = scenario.run(trial.change(control=change, best_courses=False, bound_samples=0, judge=False))
    except MocOptError as error:
        return row | {"ended": "failed", "error": f"{type(error).__name__}: {error}"}
    row["ended"] = str(trace.meta["ended"])
    if not Ending.of(row["ended"]).whole:
        return row | {"error": row["ended"]}
    metrics = summarize(trace)
    mu, replans = metrics["mu_mean"], trace.meta.get("replans", {})
    row |= {name: metrics[name] for name in ERRORS} | {
        "mu": mu, "gap_percent": 100.0 * (1.0 - mu / mine), "fraction_of_best": mu / best,
    }  # fmt: skip
    if "course_mu_mean" in trace.meta:
        row["course_gap_percent"] = 100.0 * (1.0 - float(trace.meta["course_mu_mean"]) / mine)
    if "left_course_s" in replans:
        row["left_course_s"] = replans["left_course_s"]
    elif replans:
        row["replan_ms_p99"] = replans["solve_ms_p99"]
    return row


def halving(job: Job) -> list[dict[str, Any]]:
    """Return what refinement adds to the grid's course, and what a grid twice as fine in both directions does."""
    found, coarse = plan(job.trial), plan(job.trial, refined=False)
    finer = plan(job.trial, refined=False, times=2 * len(found.targets) - 1, swivels=1440).from_start
    row = {}
    if found.from_start is not None and coarse.from_start is not None:
        base = coarse.from_start.mu_mean
        row["refined_percent"] = 100.0 * (found.from_start.mu_mean / base - 1.0)
        if finer is not None:
            row["halving_percent"] = 100.0 * (finer.mu_mean / base - 1.0)
    return [row]


def random_starts(job: Job) -> list[dict[str, Any]]:
    """Return the map's largest mu at the trial's first point, against inverse kinematics from random starts.

    Each pose that is found is then climbed along its own self-motion by continuation.
    """
    found = plan(job.trial, times=2, refined=False)
    robot, rng = job.trial.robot.arm(), np.random.default_rng([job.trial.seed, 1])
    start = found.climbed.q_rad[0]
    best = float(largest_mu(robot, start[None]).mu[0])
    reached = []
    for _ in range(job.count):
        drawn = rng.uniform(robot.q_min, robot.q_max)
        pose = solve_pose(robot, drawn, found.targets.tip[0], found.targets.wrist[0])
        if pose.found:
            with suppress(RobotError):  # singular: no curve leads through it
                reached.append(self_motion(robot, pose.q, 0.05).mu_best)
    top = max(reached, default=float("nan"))
    return [{"starts": job.count, "placed": len(reached), "map_mu": best, "random_mu": top, "above_map": top - best}]


def restarts(job: Job) -> list[dict[str, Any]]:
    """Begin the nonlinear program at courses best for a mu distorted at random; rows against the plan's own."""
    found = plan(job.trial)
    if found.from_start is None:
        return [{}]
    robot, targets = job.trial.robot.arm(), found.targets
    start = found.from_start.q_rad[0]
    grid = map_of(robot, start, targets)
    rng = np.random.default_rng([job.trial.seed, 2])
    values = []
    for _ in range(job.count):
        bent = grid.mu * np.exp(rng.normal(scale=1.0, size=(1, grid.mu.shape[1], 1)))
        phase, rate = rng.uniform(0.0, 2.0 * np.pi, 3), rng.normal(scale=1.5, size=3)
        around = 2.0 * np.pi * np.arange(grid.mu.shape[2]) / grid.mu.shape[2]
        along = np.linspace(0.0, 2.0 * np.pi, len(targets))[:, None]
        for order, (p, r) in enumerate(zip(phase, rate, strict=True), start=1):
            bent = bent * np.exp(r * np.cos(order * around + p + along * rng.integers(-2, 3)))[:, None]
        other = best_course(Value(replace(grid, mu=bent), Limits()), Limits(), start)
        if other is not None:
            values.append(refine(robot, targets, make_course(robot, targets, other), Limits()).mu_mean)
    own = found.from_start.mu_mean
    return [{"restarts": len(values), "own": own, "above_own_percent": 100.0 * (max(values) / own - 1.0),
             "as_good": sum(value > own * (1.0 - 1e-4) for value in values)}]  # fmt: skip
