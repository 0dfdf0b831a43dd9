"""The package's controller as the closed loop calls it: the loop knows neither models nor solvers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.control import Controller
from moc_opt.control.supervisor import Fault
from moc_opt.qp.problem import row_length
from moc_opt.robots.state import RobotState
from moc_opt.sim.protocols import LoggedController


class ControllerAdapter(LoggedController):
    """Makes a model's state of every measurement, and columns of the controller's answers.

    Attributes:
        state: of the model at the last tick; None before the first one.
        tip: (3,) where the last tick saw the tip [m]; zero before the first one.
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

    tip = property(lambda self: np.zeros(3) if self.state is None else self.state.tip)
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
                "x_rad_per_s": np.full((ticks, n), np.nan), "dual": np.full((ticks, 6), np.nan),
                "applied_x_rad_per_s": np.full((ticks, n), np.nan), "subproblem": np.zeros((ticks, row_length(n))),
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
        columns["x_rad_per_s"][row] = solution.x
        columns["applied_x_rad_per_s"][row] = controller.answer
        if solution.y is not None:
            columns["dual"][row] = solution.y
        columns["subproblem"][row] = qp.row
        columns["status"][row] = solution.status.label
        if solution.iterations:
            columns["iterations"][row] = solution.iterations
        if fault is not Fault.NONE:
            columns["fault"][row] = fault.label
