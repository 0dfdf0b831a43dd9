"""Choose a scenario's start pose, and lay out the task from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import ScenarioError, named
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots import available_robots
from moc_opt.robots.model import RobotModel, carried
from moc_opt.scenario import preflight
from moc_opt.scenario.config import Scenario
from moc_opt.tasks import Reference, Trocar, make_path

MOST_TICKS = 1_000_000  # largest number of ticks in a run; with 7 joints, such a run takes about 3 GB of memory

_POSE_STREAM = (1,)  # random stream of the start pose


@dataclass(frozen=True, eq=False)
class Layout:
    """A start pose, and the task laid out from it."""

    q: Array  #: (n,) joint positions at the start [rad]
    trocar: Array  #: (3,) registered trocar without breathing [m]
    registered: Trocar  #: Registered trocar as a function of time.
    reference: Reference  #: Path of the tip as a function of time.
    duration_s: float


def seeds_of(scenario: Scenario) -> tuple[int, int, int]:
    """Return the seeds of start, plant and faults."""
    start, plant, faults = np.random.SeedSequence(scenario.seed).generate_state(3).tolist()
    return start, plant, faults


def lay_out(scenario: Scenario, robot: RobotModel, *, checked: bool = True) -> Layout:
    """Choose the start, lay out the task, and check that the arm can do it.

    Raises:
        ScenarioError: start, trocar or duration are not usable.
        UnreachableError: the arm cannot do the task from this start.
    """
    start = scenario.start
    rng = np.random.default_rng(seeds_of(scenario)[0])
    fraction = rng.uniform(0.05, 0.95) if start.swivel == "random" else start.swivel

    def swivelled(q: Array) -> Array:
        return q if fraction == "given" else self_motion(robot, q).at([fraction])[0]

    if start.pose == "random":
        rng = np.random.default_rng(np.random.SeedSequence(scenario.seed, spawn_key=_POSE_STREAM))
        margins = np.where(robot.chain.prismatic, start.limit_margin_m, start.limit_margin_rad)
        return preflight.random_start(robot, rng, swivelled, lambda q: _checked(scenario, robot, q, np.inf), margins)
    q = np.array(robot.data.q_home if start.q_rad is None else start.q_rad, dtype=np.float64)
    preflight.check_start(robot, q)  # a singular pose has no swivel
    q = swivelled(q)
    if not (checked and start.check_path):
        return _task(scenario, robot, q)
    return _checked(scenario, robot, q, scenario.duration_s or np.inf)[0]


def _checked(scenario: Scenario, robot: RobotModel, q: Array, until_s: float) -> tuple[Layout, Array]:
    found = _task(scenario, robot, q)
    try:
        return found, preflight.check_reachable(robot, q, found.reference, found.registered, until_s)
    except preflight.UnreachableError as error:
        error.args = (f"{scenario.task.in_words}, {error}; [start] check_path = false skips this check",)
        raise


def _task(scenario: Scenario, robot: RobotModel, q: Array) -> Layout:
    state, trocar, task = robot.state(q), scenario.trocar, scenario.task
    if not trocar.depth_m < state.tool_span:
        raise ScenarioError(
            f"[trocar] depth_m = {trocar.depth_m}: wrist and tip are {state.tool_span:.3f} m apart; "
            "the trocar must lie between them"
        )
    point = state.tip - trocar.depth_m * state.tool_direction
    registered = Trocar(point, *(trocar.breathing if trocar.breathing_known else (0.0,)))
    with named("[task]"):
        path = make_path(
            task.path, state.tip, normal=task.normal, heading=task.heading, waypoints=task.waypoints_m, **task.sizes
        )
    reference = Reference(path, task.v_max_m_per_s, task.a_max_m_per_s2, t_start=task.wait_s)
    duration_s = scenario.duration_s or task.wait_s + reference.duration + task.hold_s
    if not duration_s / scenario.plant.period_s <= MOST_TICKS:
        parts = f"{task.in_words}: {path.length:.3g} m at {task.v_max_m_per_s:g} m/s, plus wait_s and hold_s"
        raise ScenarioError(
            f"the run takes {duration_s:.4g} s ({parts if scenario.duration_s is None else 'duration_s'}), more than "
            f"{MOST_TICKS} ticks of [plant] period_s = {scenario.plant.period_s:.3g} s: give a shorter path or time"
        )
    return Layout(q, point, registered, reference, duration_s)


def described(scenario: Scenario, robot: RobotModel) -> dict[str, Any]:
    """Return the entries of a trace's meta that describe scenario and arm."""
    found = {"scenario": scenario.model_dump(mode="json"), "robot": robot.data.name}
    return found if scenario.robot.name in available_robots() else {**found, "robot_data": carried(robot)}
