"""What a scenario configures about its controller: the solver, recorded times, the safety filter; and its columns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.control import Controller
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.control.supervisor import Fault
from moc_opt.errors import ScenarioError, SolverError, shown
from moc_opt.inputs.files import read_arrays
from moc_opt.inputs.names import RULE, is_name
from moc_opt.qp.problem import row_length
from moc_opt.robots.model import RobotModel
from moc_opt.robots.state import RobotState
from moc_opt.scenario.config import Scenario
from moc_opt.sim.plant import Stop
from moc_opt.sim.protocols import LoggedController
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


class ControllerAdapter(LoggedController):
    """The package's controller as the closed loop calls it, which knows neither models nor solvers.

    Makes a model's state of every measurement, and columns of the controller's answers; ``state`` is of the last tick.
    """

    def __init__(self, controller: Controller) -> None:
        self.controller, self._robot = controller, controller.robot
        self.state: RobotState | None = None

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Warm the controller up and start it."""
        state = self._robot.state(q, v)
        self.controller.warm_up(state, tip_ref, trocar)
        self.controller.start(state, tip_ref, trocar)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm]."""
        self.state = state = self._robot.state(q, v)
        return self.controller.tick(state, tip_ref, trocar)

    def set_applied_torque(self, tau: Array) -> None:
        """Replace the last torque."""
        self.controller.set_applied_torque(tau)

    faults = property(lambda self: self.controller.faults, doc="As `Controller.faults`.")
    restarts = property(lambda self: self.controller.restarts, doc="As `Controller.restarts`.")

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the third level's columns; none but status and solve time under DCAC."""
        n = self._robot.n
        found: dict[str, NDArray[Any]] = {
            "status": np.full(ticks, "none", dtype="<U12"), "solve_us": np.full(ticks, np.nan)
        }  # fmt: skip
        if self.controller.solver is not None:
            found |= {
                "x_rad_per_s": np.full((ticks, n), np.nan), "applied_x_rad_per_s": np.full((ticks, n), np.nan),
                "dual": np.full((ticks, 6), np.nan), "subproblem": np.zeros((ticks, row_length(n))),
                "iterations": np.zeros(ticks, dtype=np.int32), "fault": np.full(ticks, "none", dtype="<U12"),
            }  # fmt: skip
        return found

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the last tick's values into a row."""
        controller = self.controller
        solution, qp, fault = controller.solution, controller.subproblem, controller.fault
        if solution is None or qp is None:
            return
        columns["solve_us"][row] = controller.solve_us
        columns["status"][row] = solution.status.label
        columns["x_rad_per_s"][row] = solution.x
        columns["applied_x_rad_per_s"][row] = controller.answer
        columns["subproblem"][row] = qp.row
        if solution.y is not None:
            columns["dual"][row] = solution.y
        if solution.iterations:
            columns["iterations"][row] = solution.iterations
        if fault is not Fault.NONE:
            columns["fault"][row] = fault.label
