"""The control law: tau = tau_tip + tau_rcm + tau_mu, with any solver in the third level."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import float64

from moc_opt.control import tick
from moc_opt.control.climb import ScaledClimb
from moc_opt.control.guide import Guide
from moc_opt.control.isolated import IsolatedSession
from moc_opt.control.law import law_of, shaft_margin_m2
from moc_opt.control.null_space import follow_null_space, null_space
from moc_opt.control.observer import MomentumObserver
from moc_opt.control.session import check_references, start_session
from moc_opt.control.settings import ControlSettings
from moc_opt.control.supervisor import Fault, Supervisor
from moc_opt.errors import ControlError
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.model.robot_model import RobotModel, RobotState
from moc_opt.numerics.arrays import Array, read_only
from moc_opt.numerics.compiled import MATRIX, VECTOR, CompiledKernel
from moc_opt.qp.layout import offsets
from moc_opt.qp.problem import NullSpaceQP, row_length
from moc_opt.solvers.base import ObservingSession, Session, Solution, Solver

_DOUBLE, _ROWS = np.dtype(np.float64), (24, 8)

_TRACKING = CompiledKernel(tick.tracking_torque, VECTOR, VECTOR, MATRIX, MATRIX, VECTOR)
_PREPARE = CompiledKernel(tick.prepare_third_level, VECTOR, VECTOR, MATRIX, MATRIX, MATRIX, VECTOR)
_THIRD = CompiledKernel(tick.add_third_level, VECTOR, VECTOR, MATRIX, VECTOR, float64, VECTOR)


class Controller:
    """One arm, one law, one solver; call ``start`` once, then ``tick`` every period.

    After a tick, ``subproblem``, ``solution``, ``answer``, ``fault`` and ``solve_us`` say what the third
    level did (None and NaN under DCAC).

    Args:
        robot: the model that the control law uses.
        settings: see ControlSettings.
        solver: for law "moc"; None for "dcac".
        period: control period [s]; the observer integrates over it.
        times_us: recorded solve times that replace the clock where a solve has a time budget.
        guide: gives the velocity that replaces the gradient of mu; needs regularization and c2 above 0.

    Raises:
        ControlError: a law without its solver, a solver that cannot take the subproblem, a bad gain.
    """

    def __init__(
        self,
        robot: RobotModel,
        settings: ControlSettings,
        solver: Solver | None = None,
        period: float = 0.002,
        times_us: Iterator[float] | None = None,
        guide: Guide | None = None,
    ) -> None:
        if (settings.law == "moc") != (solver is not None):
            raise ControlError(
                f"law: {settings.law!r} with solver {getattr(solver, 'name', None)!r}; "
                "'moc' needs one, 'dcac' takes none"
            )
        self.robot, self.settings, self.solver, self._period = robot, settings, solver, period
        self._law = law_of(settings, robot)
        if guide is None and settings.climb == "scaled" and (settings.law, settings.third_level) == ("moc", "local"):
            guide = ScaledClimb(robot, shaft_margin_m2(settings, robot))
        self._guide, self._gradient = guide, slice(offsets(robot.n).grad_mu, offsets(robot.n).lower)
        if guide is not None:
            settings.check_guided()
        self._fade = 1.0 if settings.ramp_s == 0.0 else min(1.0, period / settings.ramp_s)
        gain = settings.observer_rate_per_s
        name = "course_observer_gain_per_s" if settings.follows else "observer_gain_per_s"
        self._observer = MomentumObserver(robot, gain, period, name) if gain else None
        self._observes = self._started = False
        self._damps = solver is None and settings.damps_dcac
        self._rest = np.zeros(robot.n)
        self._tracking_torque, self._add_third_level = _TRACKING.code, _THIRD.code
        self._prepare_third_level, self._row_length = _PREPARE.code, row_length(robot.n)
        self._supervisor = Supervisor(settings.supervisor, settings.fallback, robot.n, times_us)
        self._forget()

    def _forget(self) -> None:
        n = self.robot.n
        self._share = 0.0  # of the third level, while it fades in
        self._Z = np.zeros((0, n))
        self._tau = read_only(np.zeros(n))
        self._supervisor.forget()
        self._session: Session | None = None
        self.subproblem: NullSpaceQP | None = None
        self.solution: Solution | None = None
        self.answer = np.full(n, np.nan)

    @property
    def fault(self) -> Fault:
        """The fault of the last tick's answer."""
        return self._supervisor.fault

    @property
    def faults(self) -> dict[str, dict[str, Any]]:
        """Label of a Fault -> its ``count`` since the start, ``first_at_s`` from there, and ``first`` in words."""
        counts, firsts = self._supervisor.counts, self._supervisor.firsts
        return {
            label: {"count": counts[label], "first_at_s": self._period * first.tick, "first": first.text}
            for label, first in firsts.items()
        }

    @property
    def restarts(self) -> list[dict[str, Any]]:
        """When the process of an isolated solver was replaced since the start [s], and why."""
        found = self._session.restarts if isinstance(self._session, IsolatedSession) else []
        return [{"at_s": self._period * restart.tick, "reason": restart.reason} for restart in found]

    @property
    def solve_us(self) -> float:
        """Time of the last solve [us]; NaN where there was none."""
        return self._supervisor.solve_us

    @property
    def null_space(self) -> Array:
        """Z (r, n) of the last tick, a copy."""
        return self._Z.copy()

    @property
    def external_torque(self) -> Array:
        """The observer's estimate of the external torque (n,) [Nm], a copy; zero without an observer."""
        return (self._rest if self._observer is None else self._observer.external_torque).copy()

    def warm_up(self, state: RobotState, tip_ref: Array, trocar: Array) -> None:
        """Run one discarded tick on a copy, so that compilation is over before the loop.

        Nothing of this controller changes, and no recorded solve time is used up. Arguments and errors as for
        ``start``.
        """
        copy = Controller(self.robot, self.settings, self.solver, self._period)
        copy.start(state, tip_ref, trocar)
        copy.tick(state, tip_ref, trocar)

    def start(self, state: RobotState, tip_ref: Array, trocar: Array) -> None:
        """Reset the state and set up the solver for problems like the one at ``state``.

        Raises:
            ControlError: the solver does not support the subproblem, or raises an exception at its start.
        """
        self._forget()
        self._Z = null_space(state.A)
        self._tau = read_only(np.array(state.h))
        if self._guide is not None:
            self._guide.start()
        if self._observer is not None:
            self._observer.start(state)
        if self.solver is not None:
            tip_ref, trocar = (np.ascontiguousarray(given, dtype=np.float64) for given in (tip_ref, trocar))
            row = np.empty(self._row_length)
            tick.fill_subproblem(state.record, self._law, tip_ref, trocar, row)
            qp = NullSpaceQP.from_row(row)
            self._session = start_session(self.solver, qp)
            self._observes = isinstance(self._session, ObservingSession)
            self._supervisor.warm_up(qp, self._Z)
        self._started = True

    def tick(self, state: RobotState, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] of this period.

        Args:
            state: of the model at the measured q and v.
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            trocar: (2, 3) rows P_t [m], dP_t [m/s], as registered.

        Raises:
            ControlError: not started, or a reference of the wrong shape.
        """
        tip_ref, trocar = self._checked(tip_ref, trocar)
        record, law, x, share = state.record, self._law, self._rest, 1.0
        # r = K_o (p - integral(tau + C^T v - g + r)): friction and model error, from the last torque.
        r = self._rest if self._observer is None else self._observer.update(state, self._tau)
        # tau = tau_tip + tau_rcm - r
        tau = self._tracking_torque(record, law, tip_ref, trocar, r)
        if self._session is not None:
            # x*: the subproblem's answer, or the supervisor's substitute.
            x = self._solve(self._session, state, tip_ref, trocar)
            self._share = share = min(1.0, self._share + self._fade)
        elif self._damps:
            self._follow_null_space(state)
        # tau += M Z^T (Z M Z^T)^-1 Z (K_N2 (x* - v) - D_N2 v), cut at tau_max
        self._add_third_level(record, law, self._Z, x, share, tau)
        self._tau = read_only(tau)
        return tau

    def set_applied_torque(self, tau: Array) -> None:
        """Replace the last torque by the one (n,) [Nm] that was applied: the observer uses it."""
        self._tau = read_only(np.array(tau, dtype=np.float64))

    def _checked(self, tip_ref: Array, trocar: Array) -> tuple[Array, Array]:
        """Return the references as contiguous float64, which compiled code requires."""
        check_references(self._started, tip_ref, trocar)
        if tip_ref.strides != _ROWS or tip_ref.dtype is not _DOUBLE:
            tip_ref = np.ascontiguousarray(tip_ref, dtype=np.float64)
        if trocar.strides != _ROWS or trocar.dtype is not _DOUBLE:
            trocar = np.ascontiguousarray(trocar, dtype=np.float64)
        return tip_ref, trocar

    def _solve(self, session: Session, state: RobotState, tip_ref: Array, trocar: Array) -> Array:
        """Return the x (n,) [rad/s] that the arm follows; also sets ``subproblem``, ``solution`` and ``answer``."""
        row = np.empty(self._row_length)
        if not self._prepare_third_level(state.record, self._law, tip_ref, trocar, self._Z, row):
            self._Z = null_space(state.A, like=self._Z)
        if self._guide is not None:  # in the place of grad mu
            row[self._gradient] = self.settings.regularization / self.settings.c2 * self._guide.desired_velocity(state)
        self.subproblem = qp = NullSpaceQP.from_row(row)
        v = state.v if self._observes else None
        self.solution, self.answer = self._supervisor.solve(session, qp, self._Z, v)
        return self.answer

    def _follow_null_space(self, state: RobotState) -> None:
        views = state_views.py_func(state.record, state.n)
        if not follow_null_space(views.A, views.u, self._Z):
            self._Z = null_space(state.A, like=self._Z)
