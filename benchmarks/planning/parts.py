"""The parts of the planning benchmark, one function a part; each returns rows."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from moc_opt import scenario
from moc_opt.comparison.trials import placed
from moc_opt.errors import MocOptError, RobotError
from moc_opt.model.inverse_kinematics import solve_pose
from moc_opt.planning.course import make_course
from moc_opt.planning.plan import map_of
from moc_opt.planning.pose_map import spherical_map
from moc_opt.planning.refine import refine
from moc_opt.planning.search import search
from moc_opt.planning.spherical import spherical
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.scenario import Scenario
from moc_opt.scenario.planned import plan
from moc_opt.trace.ending import Ending
from moc_opt.trace.metrics import summarize

ERRORS = ("tip_error_model_mean_mm", "rcm_error_model_mean_mm")
"""By the robot's own kinematics, from the registered trocar."""
MAP_SIZE = (1000, 720)
"""Points of the path and swivels of the timed map; there are 8 branches."""


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
    work: Callable[[Job], list[dict[str, Any]]] = {
        "courses": courses, "halving": halving, "closed_form": closed_form, "restarts": restarts, "map": map_time
    }[job.part]  # fmt: skip
    try:
        rows = work(job)
    except MocOptError as error:
        rows = [{"error": f"{type(error).__name__}: {error}"}]
    return [job.row() | row for row in rows]


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
        "solve_p99_us": metrics.get("solve_p99_us"),
    }  # fmt: skip
    if "course_mu_mean" in trace.meta:
        row["course_gap_percent"] = 100.0 * (1.0 - float(trace.meta["course_mu_mean"]) / mine)
    if "left_course_s" in replans:
        row["left_course_s"] = replans["left_course_s"]
    elif replans:
        row |= {f"replan_{name}": replans[f"solve_{name}"] for name in ("ms_median", "ms_p99")}
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


def closed_form(job: Job) -> list[dict[str, Any]]:
    """Return the map's largest mu at the trial's first point, against inverse kinematics from random starts.

    Each pose that is found is then climbed along its own self-motion by continuation.
    """
    found = plan(job.trial, times=2, refined=False)
    robot, rng = job.trial.robot.arm(), np.random.default_rng([job.trial.seed, 1])
    start = found.climbed.q_rad[0]
    best = float(map_of(robot, start, found.targets).highest()[0])
    reached = []
    for _ in range(job.count):
        placed = solve_pose(
            robot, rng.uniform(robot.q_min, robot.q_max), found.targets.tip[0], found.targets.wrist[0]
        )
        if placed.found:
            try:
                reached.append(self_motion(robot, placed.q, 0.05).mu_best)
            except RobotError:
                continue  # singular: no curve leads through it
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
    step, rng = robot.v_max * targets.period_s, np.random.default_rng([job.trial.seed, 2])
    values = []
    for _ in range(job.count):
        bent = grid.mu * np.exp(rng.normal(scale=1.0, size=(1, grid.mu.shape[1], 1)))
        phase, rate = rng.uniform(0.0, 2.0 * np.pi, 3), rng.normal(scale=1.5, size=3)
        around = 2.0 * np.pi * np.arange(grid.mu.shape[2]) / grid.mu.shape[2]
        along = np.linspace(0.0, 2.0 * np.pi, len(targets))[:, None]
        for order, (p, r) in enumerate(zip(phase, rate, strict=True), start=1):
            bent = bent * np.exp(r * np.cos(order * around + p + along * rng.integers(-2, 3)))[:, None]
        other = search(replace(grid, mu=bent), step, start=(start, float(robot.state(start).mu)))
        if other.q_rad is not None:
            values.append(refine(robot, targets, make_course(robot, targets, other.q_rad)).mu_mean)
    own = found.from_start.mu_mean
    return [{"restarts": len(values), "own": own, "above_own_percent": 100.0 * (max(values) / own - 1.0),
             "as_good": sum(value > own * (1.0 - 1e-4) for value in values)}]  # fmt: skip


def map_time(job: Job) -> list[dict[str, Any]]:
    """Time of the whole map of one path on one core: the best of five, after one that compiles."""
    robot = job.trial.robot.arm()
    arm = spherical(robot)
    if arm is None:
        raise RobotError(f"{robot.data.name}: no closed form, its map is not timed")
    count, swivels = MAP_SIZE
    targets = plan(job.trial, times=count, swivels=8, refined=False).targets
    spent = []
    for _ in range(6):
        began = time.perf_counter()
        spherical_map(robot, arm, targets, swivels=swivels).feasible()
        spent.append(time.perf_counter() - began)
    return [{"map_s": min(spent[1:]), "map_median_s": float(np.median(spent[1:])), "poses": count * swivels * 8}]

