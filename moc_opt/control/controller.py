"""The stack: tau = tau_tip + tau_rcm + tau_mu, with any solver in the third level."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import bool_, float64, int64
from numpy.typing import NDArray

from moc_opt.control import null_space as manipulability
from moc_opt.control import tick
from moc_opt.control.guide import Guide
from moc_opt.control.observer import MomentumObserver
from moc_opt.control.rcm import PROJECTORS
from moc_opt.control.settings import ControlSettings, per_joint
from moc_opt.control.supervisor import Fault, Supervisor
from moc_opt.errors import ControlError, MocOptError, describe
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.model.robot_model import RobotModel, RobotState
from moc_opt.numerics.compiled import MATRIX, VECTOR, CompiledKernel
from moc_opt.qp.problem import NullSpaceQP, row_length
from moc_opt.solvers.base import Session, Solution, Solver

Array = NDArray[np.float64]

_DOUBLE, _ROWS = np.dtype(np.float64), (24, 8)

_BEFORE_SOLVER = CompiledKernel(
    tick.before_solver, VECTOR, int64, MATRIX, MATRIX, VECTOR, int64, bool_, float64, MATRIX, VECTOR, float64, MATRIX,
    VECTOR, VECTOR,
)  # fmt: skip
_TRACKING_TORQUE = CompiledKernel(tick.tracking_torque, VECTOR, int64, MATRIX, MATRIX, VECTOR, int64, bool_, float64)
_AFTER_SOLVER = CompiledKernel(
    tick.after_solver, VECTOR, int64, MATRIX, VECTOR, VECTOR, VECTOR, float64, VECTOR, VECTOR, VECTOR
)


class Controller:
    """One arm, one law, one solver; ``start`` once, then ``tick`` every period.

    After a tick, ``subproblem``, ``solution``, ``answer``, ``fault`` and ``solve_us`` say what the third
    level did (None and NaN under DCAC).

    Args:
        robot: the model that the control law believes in.
        settings: see ControlSettings.
        solver: for law "moc"; None for "dcac".
        period: control period [s]; the observer integrates over it.
        times_us: recorded solve times that replace the clock where a solve has a time budget.
        guide: what the third level follows in place of the gradient of mu; needs rho and c2 above 0.

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
        gains = settings.resolve_gains(robot.data.gains, robot.n)
        self._gains = np.array([gains.K_X, gains.D_X, gains.K_N, gains.D_N])
        self._projector = PROJECTORS.index(settings.projector)
        self._rcm_lambda = 0.0 if settings.rcm_lambda is None else settings.rcm_lambda
        self._limits = manipulability.box_limits(
            robot.q_min, robot.q_max, robot.v_max,
            margin=settings.limit_margin_rad, speed_fraction=settings.speed_fraction,
        )  # fmt: skip
        self._guide, self._pull_of_wish = guide, 0.0
        if guide is not None:
            settings.check_guided()
            self._pull_of_wish = settings.regularization / settings.c2
        self._fade = 1.0 if settings.ramp_s == 0.0 else min(1.0, period / settings.ramp_s)
        self._weights = np.array([settings.c0, settings.c1, settings.c2, settings.regularization])
        self._feedforward, self._k0 = settings.feedforward, settings.k0_per_s
        self._pull, self._damping = gains.K_N2, gains.D_N2
        if settings.law == "dcac":
            self._damping = per_joint("[control] dcac_damping", settings.dcac_damping, robot.n)
        self._tau_max = np.array(robot.tau_max) if settings.limit_torque else np.full(robot.n, np.inf)
        self._row_length = row_length(robot.n)
        self._observer = (
            MomentumObserver(robot, settings.observer_gain_per_s, period)
            if settings.observer_gain_per_s
            else None
        )
        self._uses_null_space = solver is not None or settings.damps_dcac
        self._started = False
        self._session: Session | None = None
        self._listens = False  # whether the session observes the measured velocity
        self._rest = np.zeros(robot.n)
        self._before_solver, self._after_solver = _BEFORE_SOLVER.code, _AFTER_SOLVER.code
        self._tracking_torque = _TRACKING_TORQUE.code
        self._supervisor = Supervisor(settings.supervisor, settings.fallback, robot.n, times_us)
        self._forget()

    def _forget(self) -> None:
        n = self.robot.n
        self._share = 0.0  # of the third level
        self._Z = np.zeros((0, n))
        self._tau = _read_only(np.zeros(n))
        self._supervisor.forget()
        self.subproblem: NullSpaceQP | None = None
        self.solution: Solution | None = None
        self.answer = np.full(n, np.nan)

    @property
    def fault(self) -> Fault:
        """What was wrong with the last tick's answer."""
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
    def solve_us(self) -> float:
        """Time of the last solve [us]; NaN where there was none."""
        return self._supervisor.solve_us

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
            ControlError: the solver says that it cannot take the subproblem, or raises when it is asked or started.
        """
        self._forget()
        self._Z = manipulability.null_space(state.A)
        self._tau = _read_only(np.array(state.h))
        if self._guide is not None:
            self._guide.start()
        if self._observer is not None:
            self._observer.start(state)
        if self.solver is not None:
            references = (np.ascontiguousarray(given, dtype=np.float64) for given in (tip_ref, trocar))
            qp = self._build(state, *references)
            self._session, self._listens = _started(self.solver, qp)
            self._supervisor.warm_up(qp, self._Z)
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
        # What is compiled takes kind and order of their memory for granted.
        if tip_ref.strides != _ROWS or tip_ref.dtype is not _DOUBLE:
            tip_ref = np.ascontiguousarray(tip_ref, dtype=np.float64)
        if trocar.strides != _ROWS or trocar.dtype is not _DOUBLE:
            trocar = np.ascontiguousarray(trocar, dtype=np.float64)
        robot, record, gains = self.robot, state.record, self._gains
        if self._session is not None:
            tau, row = np.empty(robot.n), np.empty(self._row_length)
            if not self._before_solver(
                record,
                robot.n,
                tip_ref,
                trocar,
                gains,
                self._projector,
                self._feedforward,
                self._rcm_lambda,
                self._limits,
                self._weights,
                self._k0,
                self._Z,
                tau,
                row,
            ):
                self._Z = manipulability.null_space(state.A, like=self._Z)
            if self._guide is not None:  # in the place of grad mu
                row[6 * robot.n + 6 : 7 * robot.n + 6] = self._pull_of_wish * self._guide.wish(state)
            x = self._answer(self._session, NullSpaceQP.from_row(row), state)
            self._share = min(1.0, self._share + self._fade)
            share = self._share
        else:
            tau = self._tracking_torque(
                record, robot.n, tip_ref, trocar, gains, self._projector, self._feedforward, self._rcm_lambda
            )
            if self._uses_null_space:
                self._follow_null_space(state)
            x, share = self._rest, 1.0
        disturbance = self._rest if self._observer is None else self._observer.update(state, self._tau)
        self._after_solver(
            record, robot.n, self._Z, x, self._pull, self._damping, share, disturbance, self._tau_max, tau
        )
        tau.setflags(write=False)
        self._tau = tau
        return tau

    def set_applied_torque(self, tau: Array) -> None:
        """Say what torque (n,) [Nm] really went to the arm, where a limit changed it: the observer uses it."""
        self._tau = _read_only(np.array(tau, dtype=np.float64))

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
        """The x that the arm follows: the solver's, or what stands in for it."""
        self.subproblem = qp
        v = state.v if self._listens else None
        self.solution, self.answer = self._supervisor.solve(session, qp, self._Z, v)
        return self.answer

    def _follow_null_space(self, state: RobotState) -> None:
        views = state_views.py_func(state.record, state.n)
        if not manipulability.follow_null_space(views.A, views.u, self._Z):
            self._Z = manipulability.null_space(state.A, like=self._Z)


def _started(solver: Solver, qp: NullSpaceQP) -> tuple[Session, bool]:
    """A session for problems like ``qp``, and whether it observes the measured velocity.

    Raises:
        ControlError: the solver does not take the problem or hands back no session, in its own words or in those of
            what it raised. A MocOptError of its own passes.
    """
    name = "?"
    try:
        name = repr(solver.name)
        reason = solver.supports(qp.copy())
        if reason is None:
            session = solver.start(qp.copy())
            if callable(getattr(session, "solve", None)):
                return session, hasattr(session, "observe")
            reason = f"start returned a {type(session).__name__} without solve: return a Session"
        elif not isinstance(reason, str):
            reason = f"supports returned a {type(reason).__name__}: return None or the reason why not"
    except (KeyboardInterrupt, MocOptError):
        raise
    except BaseException as error:  # foreign code may raise anything
        raise ControlError(f"solver {name} cannot run in this controller: {describe(error)}") from error
    raise ControlError(f"solver {name} cannot run in this controller: {reason}")


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array
