"""The stack: tau = tau_tip + tau_rcm + tau_mu, with any solver in the third level."""

from __future__ import annotations

from time import perf_counter_ns
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from moc_opt.control import manipulability, tick
from moc_opt.control.observer import MomentumObserver
from moc_opt.control.rcm import PROJECTORS
from moc_opt.control.settings import GAINS, ControlSettings
from moc_opt.errors import ControlError
from moc_opt.model import RobotModel, RobotState
from moc_opt.model_kernels import state_views
from moc_opt.solvers.base import Session, Solution, Solver, Status
from moc_opt.subproblem import NullSpaceQP, row_length

Array = NDArray[np.float64]

# Statuses whose x, where there is one, still goes to the arm: a truncated iterate is an answer.
USABLE = (Status.SOLVED, Status.MAX_ITER, Status.TIME_LIMIT)


class ObservesVelocity(Protocol):
    """A session that wants the measured velocity before each solve (``rnn-printed``)."""

    def observe(self, v: Array) -> None:
        """Take in the measured joint velocity (n,) [rad/s]."""
        ...


class Controller:
    """One arm, one law, one solver; ``start`` once, then ``tick`` every period.

    After a tick, ``subproblem``, ``solution``, ``answer`` and ``solve_us`` say what the third
    level did (None and NaN under DCAC).

    Args:
        robot: the model that the control law believes in.
        settings: see ControlSettings.
        solver: for law "moc"; None for "dcac".
        period: control period [s]; the observer integrates over it.

    Raises:
        ControlError: a law without its solver, a solver that cannot take the subproblem, a bad gain.
    """

    def __init__(
        self,
        robot: RobotModel,
        settings: ControlSettings,
        solver: Solver | None = None,
        period: float = 0.002,
    ) -> None:
        if (settings.law == "moc") != (solver is not None):
            raise ControlError(
                f"law: {settings.law!r} with solver {getattr(solver, 'name', None)!r}; "
                "'moc' needs one, 'dcac' takes none"
            )
        self.robot, self.settings, self.solver = robot, settings, solver
        found = settings.resolve_gains(robot.data.gains)
        self._gains = np.array([found[gain] for gain in GAINS])
        self._projector = PROJECTORS.index(settings.projector)
        self._limits = np.ascontiguousarray([robot.q_min, robot.q_max, robot.v_max])
        self._weights = np.array([settings.c0, settings.c1, settings.c2, settings.damping])
        self._row_length = row_length(robot.n)
        self._observer = (
            MomentumObserver(robot, settings.observer_gain_per_s, period)
            if settings.observer_gain_per_s
            else None
        )
        self._uses_null_space = solver is not None or settings.dcac_damping > 0.0
        self._started = False
        self._session: Session | None = None
        self._listener: ObservesVelocity | None = None
        self._rest = np.zeros(robot.n)
        self._forget()

    @property
    def null_space(self) -> Array:
        """Z (r, n) of the last tick, a copy."""
        return self._Z.copy()

    @property
    def external_torque(self) -> Array:
        """What the observer makes of the torque from outside (n,) [Nm], a copy; zero without one."""
        return (self._rest if self._observer is None else self._observer.external_torque).copy()

    def start(self, state: RobotState, tip_ref: Array, trocar: Array) -> None:
        """Forget the past and set up the solver for problems like the one at ``state``.

        Raises:
            ControlError: the solver says that it cannot take the subproblem.
        """
        self._forget()
        self._Z = manipulability.null_space(state.A)
        self._tau = _read_only(np.array(state.h))
        if self._observer is not None:
            self._observer.start(state)
        if self.solver is not None:
            qp = self._build(state, tip_ref, trocar)
            reason = self.solver.supports(qp)
            if reason is not None:
                raise ControlError(f"solver {self.solver.name!r} cannot run in this controller: {reason}")
            self._session = self.solver.start(qp)
            self._listener = (
                cast(ObservesVelocity, self._session) if hasattr(self._session, "observe") else None
            )
            self._fall_back(qp)  # so that no compiler runs in the loop
        self._started = True

    def tick(self, state: RobotState, tip_ref: Array, trocar: Array) -> Array:
        """Torque (n,) [Nm] for this period.

        Args:
            state: what the model makes of the measured q and v.
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            trocar: (2, 3) rows P_t [m], dP_t [m/s], as registered.

        Raises:
            ControlError: not started, or a reference of the wrong shape.
        """
        if not self._started:
            raise ControlError(
                "tick before start: call start(state, tip_ref, trocar) once before the first tick"
            )
        if tip_ref.shape != (3, 3) or trocar.shape != (2, 3):
            raise ControlError(
                f"tip_ref has shape {tip_ref.shape}, trocar {trocar.shape}: give (3, 3) and (2, 3), a row a derivative"
            )
        n, record, settings = self.robot.n, state.record, self.settings
        tau = tick.tracking_torque(
            record, n, tip_ref, trocar, self._gains, self._projector, settings.feedforward
        )
        if self._uses_null_space:
            self._follow_null_space(state)
            if self._session is not None:
                x = self._answer(self._session, self._build(state, tip_ref, trocar), state)
                tau += tick.third_level(record, n, self._Z, x, self._gains[4], self._gains[5])
            else:
                tau += tick.third_level(record, n, self._Z, self._rest, settings.dcac_damping, 0.0)
        if self._observer is not None:
            tau -= self._observer.update(state, self._tau)
        if settings.limit_torque:
            np.minimum(tau, self.robot.tau_max, out=tau)
            np.maximum(tau, -self.robot.tau_max, out=tau)
        self._tau = _read_only(tau)
        return tau

    def _forget(self) -> None:
        n = self.robot.n
        self._Z, self._tau, self._held = np.zeros((0, n)), np.zeros(n), np.zeros(n)
        self.subproblem: NullSpaceQP | None = None
        self.solution: Solution | None = None
        self.answer = np.full(n, np.nan)
        self.solve_us = float("nan")

    def _build(self, state: RobotState, tip_ref: Array, trocar: Array) -> NullSpaceQP:
        row = np.empty(self._row_length)
        tick.fill_subproblem(
            state.record,
            self.robot.n,
            tip_ref,
            trocar,
            self._limits,
            self._weights,
            self.settings.k0_per_s,
            row,
        )
        return NullSpaceQP.from_row(row)

    def _answer(self, session: Session, qp: NullSpaceQP, state: RobotState) -> Array:
        """The solver's x, or the fallback where it has none."""
        if self._listener is not None:
            self._listener.observe(state.v)
        begin = perf_counter_ns()
        solution = session.solve(qp)
        self.solve_us = (perf_counter_ns() - begin) * 1e-3
        self.subproblem, self.solution = qp, solution
        if solution.status in USABLE and np.isfinite(solution.x).all():
            # A copy: the solver may write its next answer, or none, into the same memory.
            self._held = self.answer = np.array(solution.x)
        else:
            self.answer = self._fall_back(qp)
        return self.answer

    def _fall_back(self, qp: NullSpaceQP) -> Array:
        if self.settings.fallback == "hold":
            return self._held
        if self.settings.fallback == "least-violation":
            part = qp.fields
            x: Array = manipulability.least_violation(part.A, part.b, part.lower, part.upper, 50)
            return x
        return self._rest

    def _follow_null_space(self, state: RobotState) -> None:
        views = state_views.py_func(state.record, state.n)
        if not manipulability.follow_null_space(views.A, views.u, self._Z):
            self._Z = manipulability.null_space(state.A, like=self._Z)


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array
