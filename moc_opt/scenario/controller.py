"""What a scenario configures about its controller: the solver, recorded times, the safety filter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.errors import ScenarioError, SolverError, shown
from moc_opt.inputs.files import read_arrays
from moc_opt.inputs.names import RULE, is_name
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.sim.plant import Stop
from moc_opt.solvers.base import Solver
from moc_opt.solvers.isolated import Isolated
from moc_opt.solvers.registry import find


def check_solver(given: object) -> None:
    """Refuse what is no solver: a name, a class that has not been called, any other object; a SolverError says so."""
    if isinstance(given, type):
        raise SolverError(f"{shown(given)} is a class, no solver: call it, as in {given.__name__}()")
    if not isinstance(given, Solver):
        cure = "it needs a name, supports(qp) and start(qp); solvers.create(name) makes one"
        raise SolverError(f"{shown(given, 80)} is no solver: {cure}")
    if not is_name(given.name):
        raise SolverError(f"{shown(given, 80)}: name = {shown(given.name, 80)}: {RULE}")


def make_solver(name: str, robot: RobotModel, **settings: Any) -> Solver:
    """Create a solver, giving it the arm's kinematics where it can use them."""
    entry = find(name)
    if "kinematics" not in settings and "kinematics" in entry.parameters:
        settings = {**settings, "kinematics": robot.kinematics()}
    return entry.create(**settings)


def isolated(solver: Solver, scenario: Scenario, budget_us: float = math.inf, realtime: bool = False) -> Solver:
    """Wrap a solver in its own process if ``[solver]`` requires it; else return the solver itself.

    Args:
        budget_us: how long a tick waits for its answer [us]; at most until the process counts as hung.
        realtime: the loop runs against a wall clock, and does not wait while a process is replaced.

    Raises:
        SolverError: pickle cannot copy the solver.
    """
    if scenario.solver.isolation == "none":
        return solver
    return Isolated(solver, budget_us=budget_us, waits=not realtime, **scenario.solver.process.model_dump())


def make_safety_filter(robot: RobotModel, scenario: Scenario) -> SafetyFilter:
    """Make the safety filter of an arm in its incision, with everything it can check."""
    return SafetyFilter(robot, scenario.told_guard, scenario.plant.period_s)


def make_stop(scenario: Scenario) -> Stop:
    """Return how the settings of the safety filter stop an arm."""
    return Stop(scenario.guard.stop_damping_Nm_s_per_rad, scenario.guard.stop_s)


def recorded_times(scenario: Scenario) -> list[float] | None:
    """Read the times [us] of ``[solver] replay_us``; None: the clock decides. A ScenarioError refuses a wrong file."""
    given = scenario.solver.replay_us
    if given is None:
        return None
    if isinstance(given, str):
        times = read_arrays(given, "[solver] replay_us", ScenarioError).get("", np.empty(0))
    else:
        times = np.asarray(given)
    if times.dtype.kind not in "fiu" or times.ndim != 1 or not len(times) or not (times >= 0.0).all():
        cure = "give one time of 0 us or more a tick, at least one"
        raise ScenarioError(f"[solver] replay_us: {times.dtype} of shape {times.shape}: {cure}")
    return [float(time) for time in times]
