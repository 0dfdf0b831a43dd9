"""The controller: tau = tau_tip + tau_rcm + tau_mu, the torques of levels 1 to 3, computed in core/law.c."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from moc_opt import core
from moc_opt.arrays import Array, read_only
from moc_opt.control.law_numbers import numbers_of
from moc_opt.control.settings import ControlSettings
from moc_opt.control.supervisor import Fault, Supervisor
from moc_opt.errors import ControlError, MocOptError, located
from moc_opt.qp.problem import NullSpaceQP, row_length
from moc_opt.robots.model import RobotModel, RobotState
from moc_opt.solvers.base import ObservingSession, Session, Solution, Solver, Status, no_answer
from moc_opt.solvers.exact import Exact
from moc_opt.solvers.isolated import IsolatedSession


class Guide(Protocol):
    """A source of joint velocities x_d that the elbow follows instead of the gradient of mu.

    The subproblem's cost has the term -c2 x^T pull. With a guide, pull is (rho / c2) x_d instead of the gradient of mu.
    Then the optimum is the feasible x nearest to x_d.
    """

    def start(self) -> None:
        """Reset to t = 0. Raise a TaskError if there is no course."""

    def desired_velocity(self, state: RobotState) -> Array:
        """Return x_d (n,) [rad/s] for this tick. The controller calls this method once per tick."""


class Controller:
    """Compute the torques of one arm. Call ``start`` once, then ``tick`` every period.

    Args:
        robot: the model that the control law uses.
        settings: see ControlSettings.
        solver: solver of level 3 for law "moc"; None for law "dcac".
        period: control period [s].
        times_us: recorded solve times [us], used instead of the clock while they last; None: the clock.
        guide: gives the joint velocities x_d that the elbow follows. The settings `regularization` (rho) and `c2` must
            then be above 0. None: the elbow raises mu.

    Raises:
        ControlError: the solver or a setting does not fit the law or the robot.
    """

    def __init__(
        self, robot: RobotModel, settings: ControlSettings, solver: Solver | None = None, period: float = 0.002,
        times_us: Iterator[float] | None = None, guide: Guide | None = None,
    ) -> None:  # fmt: skip
        if (settings.law == "moc") != (solver is not None):
            name = getattr(solver, "name", None)
            raise ControlError(f"law = {settings.law!r} with solver {name!r}: 'moc' needs a solver, 'dcac' takes none")
        self.robot, self.settings, self.solver, self._period = robot, settings, solver, period
        self._law = core.Law(robot.arm, **numbers_of(settings, robot, period))
        if guide is not None or (settings.climb == "scaled" and settings.law == "moc"):
            settings.check_guided()
        self._guide, self._n, self._row_length = guide, robot.n, row_length(robot.n)
        self._torques = slice(-robot.n, None)
        self._exact = solver if type(solver) is Exact else None
        self._started = False
        self._supervisor = Supervisor(settings.supervisor, self._law, robot.n, period, times_us)
        self._forget()

    def _forget(self) -> None:
        self._supervisor.forget()
        self._session: Session | None = None
        self._subproblem: NullSpaceQP | None = None
        self._solution: Solution | None = None
        self._answer = np.full(self._n, np.nan)
        self._ticked: tuple[Status, Array] | None = None

    def _take_apart(self) -> None:
        if self._ticked is None:
            return
        status, out = self._ticked
        end, n, self._ticked = self._row_length, self._n, None
        self._subproblem = NullSpaceQP.from_row(out[:end])
        x, y = out[end : end + n], out[end + n : end + n + 6]
        self._solution = Solution(x, y, status) if status is Status.SOLVED else no_answer(n, status)
        self._answer = out[end + n + 6 : end + 2 * n + 6]

    @property
    def state(self) -> RobotState:
        """The state of the robot's model at the q and v of the last tick."""
        return RobotState(self._record, self._n)

    @property
    def subproblem(self) -> NullSpaceQP | None:
        """The subproblem of the last tick; None under DCAC."""
        self._take_apart()
        return self._subproblem

    @property
    def solution(self) -> Solution | None:
        """The solver's answer in the last tick; None under DCAC."""
        self._take_apart()
        return self._solution

    @property
    def answer(self) -> Array:
        """The x (n,) [rad/s] that level 3 followed: the solver's answer or its replacement. NaN under DCAC."""
        self._take_apart()
        return self._answer

    fault = property(lambda self: self._supervisor.fault, doc="The fault of the last tick's answer.")
    solve_us = property(
        lambda self: self._supervisor.solve_us,
        doc="Solve time of the last tick [us]. For `exact`, the core measures it. NaN if nothing was solved.",
    )
    faults = property(
        lambda self: self._supervisor.faults,
        doc="Faults since the start, by label: dicts of ``count``, ``first_at_s`` and ``first`` (the first message).",
    )

    @property
    def restarts(self) -> list[dict[str, Any]]:
        """Restarts of an isolated solver's process, each with ``at_s`` [s] and ``reason``."""
        found = self._session.restarts if isinstance(self._session, IsolatedSession) else []
        return [{"at_s": self._period * restart.tick, "reason": restart.reason} for restart in found]

    @property
    def null_space(self) -> Array:
        """The last tick's Z (r, n). Its rows are an orthonormal basis of ker A."""
        rows, Z, _ = self._law.memory()
        return Z[:rows]

    @property
    def external_torque(self) -> Array:
        """The observer's estimate of the external torque (n,) [Nm]; zero without an observer."""
        return self._law.memory()[2]

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Reset the controller, and start its solver; arguments as for `tick`.

        Raises:
            ControlError: the solver cannot start.
            TaskError: the guide has no course.
        """
        # First, a copy of the controller runs one tick, which initializes all libraries.
        copy = Controller(self.robot, self.settings, self.solver, self._period)
        copy._begin(q, v, tip_ref, trocar)
        copy.tick(q, v, tip_ref, trocar)
        self._begin(q, v, tip_ref, trocar)

    def _begin(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        self._forget()
        tip_ref, trocar = _rows("tip_ref", tip_ref, 3), _rows("trocar", trocar, 2)
        state = self.robot.state(q, v)
        self._record, row = self._law.start(state.q, state.v, tip_ref, trocar)
        if self._guide is not None:
            self._guide.start()
        if self.solver is not None:
            self._session = _start_session(self.solver, NullSpaceQP.from_row(row))
            self._observes = isinstance(self._session, ObservingSession)
        self._started = True

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] of this period.

        Args:
            q, v: (n,) measured joint positions [rad] and velocities [rad/s].
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            trocar: (2, 3) rows P_t [m], dP_t [m/s] of the registered trocar.

        Raises:
            ControlError: `start` was not called, or a reference is malformed.
        """
        if not self._started:
            raise ControlError("tick before start: call start once before the first tick")
        x_d = None if self._guide is None else self._guide.desired_velocity(self.robot.state(q, v))
        try:
            return self._torque(q, v, tip_ref, trocar, x_d)
        except ValueError:  # the core takes only contiguous float arrays
            state, tip_ref, trocar = self.robot.state(q, v), _rows("tip_ref", tip_ref, 3), _rows("trocar", trocar, 2)
            return self._torque(state.q, state.v, tip_ref, trocar, x_d)

    def _torque(self, q: Array, v: Array, tip_ref: Array, trocar: Array, x_d: Array | None) -> Array:
        if self._exact is not None:
            status, self._record, out = self._supervisor.step(q, v, tip_ref, trocar, x_d, self._exact.tolerance)
            self._ticked = status, out
            return out[self._torques]
        self._record, row = self._law.begin(q, v, tip_ref, trocar, x_d)
        if self._session is not None:
            self._subproblem = qp = NullSpaceQP.from_row(row)
            seen = v if self._observes else None
            self._solution, self._answer, tau = self._supervisor.solve(self._session, qp, seen)
        else:
            tau = self._law.finish(0, 0, v, 0.0)[2]
        return read_only(tau)

    def set_applied_torque(self, tau: Array) -> None:
        """Tell the observer which torque (n,) [Nm] was applied instead of the result of `tick`."""
        if not np.isfinite(tau).all():
            raise ControlError(f"applied torque = {np.asarray(tau).tolist()} is not finite: the observer cannot use it")
        self._law.set_applied(np.ascontiguousarray(tau, dtype=np.float64))

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the trace columns of level 3, with one row per tick."""
        found: dict[str, NDArray[Any]] = {
            "status": np.full(ticks, "none", dtype="<U12"), "solve_us": np.full(ticks, np.nan)
        }  # fmt: skip
        if self.solver is not None:
            n, end = self._n, self._row_length
            # The block's columns are in the order of ``out`` of `Supervisor.step`.
            self._block = block = np.full((ticks, end + 2 * n + 6), np.nan)
            found |= {
                "subproblem": block[:, :end], "x_rad_per_s": block[:, end : end + n],
                "dual": block[:, end + n : -n], "applied_x_rad_per_s": block[:, -n:],
                "iterations": np.zeros(ticks, dtype=np.int32), "fault": np.full(ticks, "none", dtype="<U12"),
            }  # fmt: skip
            found["subproblem"][:] = 0.0
        return found

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the last tick's values into row ``row`` of ``columns``."""
        if self._ticked is not None and self._ticked[0] is Status.SOLVED:
            status, out = self._ticked
            self._block[row] = out[: -self._n]
        elif (solution := self.solution) is not None and (qp := self.subproblem) is not None:
            status, columns["subproblem"][row], columns["x_rad_per_s"][row] = solution.status, qp.row, solution.x
            columns["applied_x_rad_per_s"][row] = self.answer
            if solution.y is not None:
                columns["dual"][row] = solution.y
            columns["iterations"][row] = solution.iterations
        else:
            return
        columns["solve_us"][row], columns["status"][row] = self.solve_us, status.label
        if self.fault is not Fault.NONE:
            columns["fault"][row] = self.fault.label


def _rows(name: str, given: Array, count: int) -> Array:
    if np.shape(given) != (count, 3):
        raise ControlError(f"{name} has shape {np.shape(given)}: give ({count}, 3), the position and its derivatives")
    rows = np.ascontiguousarray(given, dtype=np.float64)
    if not np.isfinite(rows).all():
        raise ControlError(f"{name} = {rows.tolist()} is not finite: check where it comes from")
    return rows


def _start_session(solver: Solver, qp: NullSpaceQP) -> Session:
    name = "?"
    try:
        name = repr(solver.name)
        reason = solver.supports(qp.copy())
        if reason is None:
            session = solver.start(qp.copy())
            if callable(getattr(session, "solve", None)):
                return session
            reason = f"start returned a {type(session).__name__} that has no method `solve`: return a Session"
        elif not isinstance(reason, str):
            reason = f"supports returned a {type(reason).__name__}: return None, or the reason as a str"
    except (KeyboardInterrupt, MocOptError):
        raise
    except BaseException as error:  # a plug-in may raise anything
        raise ControlError(f"solver {name} cannot run in this controller: {located(error)}") from error
    raise ControlError(f"solver {name} cannot run in this controller: {reason}")
