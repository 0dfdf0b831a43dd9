"""The generated tick, compiled and called from Python in the simulation's loop."""

from __future__ import annotations

import ctypes
import pickle
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.control import ControlSettings
from moc_opt.control.called_tick import BAD_INPUT, TickMemory
from moc_opt.control.session import check_references
from moc_opt.embedded.compiler import compile_library
from moc_opt.embedded.export import c_files
from moc_opt.embedded.layout import Field, Layout
from moc_opt.embedded.support import TickSpec
from moc_opt.errors import ControlError, RobotError
from moc_opt.model.kinematics_kernels import record_size, state_views
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Solver, Status
from moc_opt.solvers.exact.elimination import EMPTY, OK, STUCK

_STATUS = {OK: Status.SOLVED, EMPTY: Status.INFEASIBLE, STUCK: Status.NUMERICAL}


class NativeController:
    """`Controller` in C, as the closed loop calls it (`sim.protocols.LoggedController`).

    Same torque to rounding, and the same columns in the trace except ``solve_us``: inside the compiled tick
    the solver has no clock of its own. Where the rows of tip and wrist lose rank, `exact` may still find an
    answer, and this one says ``numerical`` and falls back. One object serves one thread.

    Args:
        robot, settings, solver, period: as for `Controller`; only the solver ``exact`` can be compiled in.

    Raises:
        ControlError: a setting that generated C cannot do; the message names it.
        CompilerError: no working C compiler here.
    """

    def __init__(
        self, robot: RobotModel, settings: ControlSettings, solver: Solver | None = None, period: float = 0.002
    ) -> None:
        self.robot, self.settings, self.solver = robot, settings, solver
        plan, texts = _generated(pickle.dumps((robot.data, settings, solver, period)))
        self.library = compile_library(texts)
        found = ctypes.PyDLL(str(self.library))  # for a microsecond, letting other threads in costs more than it gives
        self._tau = np.zeros(robot.n)
        self._tip_ref, self._trocar = np.zeros((3, 3)), np.zeros((2, 3))
        state, self._state = _memory(plan.state)
        # q, v, report and a NaN in one piece, from which a state's record is taken at once.
        self._known = np.full(2 * robot.n + sum(field.length for field in plan.report) + 1, np.nan)
        self._q, self._v, report, _ = np.split(self._known, [robot.n, 2 * robot.n, -1])
        self._report = _named(report, plan.report)
        # The columns of a trace are the last fields: from the answer on.
        self._fields = [field for field in plan.report if field.name in ("x", "dual", "subproblem")]
        self._kept = report[report.size - sum(field.length for field in self._fields) :]
        self._in_state = _state_places(plan.report, robot.n)
        buffers = (self._q, self._v, self._tip_ref, self._trocar, state, self._tau, report)
        pointers = tuple(ctypes.c_void_p(buffer.ctypes.data) for buffer in buffers)
        self._start = partial(found.moc_tick_start, pointers[0], pointers[1], pointers[4])
        self._tick = partial(found.moc_tick, *pointers)
        self.memory = TickMemory(
            function=np.array([ctypes.cast(found.moc_tick, ctypes.c_void_p).value]),
            pointers=np.array([buffer.ctypes.data for buffer in buffers]), q=self._q, v=self._v,
            tip_ref=self._tip_ref, trocar=self._trocar, tau=self._tau, report=self._kept,
            torque=self._state["torque"], open=np.zeros(0, dtype=np.int64), known=self._known, places=self._in_state,
        )  # fmt: skip
        self._buffers = buffers  # the pointers do not keep them alive
        self.reports, self.most = np.empty((0, 0)), sys.maxsize
        self._status, self._started = OK, False

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Forget the past: begin at the measured q (n,) [rad], v (n,) [rad/s] with no external torque.

        Raises:
            RobotError: q or v is not finite.
        """
        self._q[:], self._v[:] = q, v
        if not (np.isfinite(self._q).all() and np.isfinite(self._v).all()):
            raise self._refusal()
        self._start()
        self._started = True

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] of this period.

        Args:
            q, v: (n,) measured [rad], [rad/s].
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            trocar: (2, 3) rows P_t [m], dP_t [m/s], as registered.

        Raises:
            RobotError, ControlError: an input or the torque is not finite; the controller's state is as before.
            ControlError: not started, or a reference of the wrong shape.
        """
        check_references(self._started, tip_ref, trocar)
        self._q[:] = q
        self._v[:] = v
        self._tip_ref[:] = tip_ref
        self._trocar[:] = trocar
        status = self._tick()
        if status == BAD_INPUT:
            raise self._refusal()
        self._status = status
        return self._tau.copy()

    def set_applied_torque(self, tau: Array) -> None:
        """Replace the last torque by the one (n,) [Nm] that was applied: the observer uses it."""
        self._state["torque"][:] = tau

    @property
    def status(self) -> Status | None:
        """The solver's answer of the last tick; None under DCAC."""
        return _STATUS[self._status] if self.solver is not None else None

    @property
    def answer(self) -> Array:
        """(n,) joint velocity that the third level followed [rad/s]; NaN under DCAC."""
        return self._report["x"].copy() if self.solver is not None else np.full(self.robot.n, np.nan)

    @property
    def subproblem(self) -> NullSpaceQP | None:
        """The subproblem of the last tick; None under DCAC."""
        return NullSpaceQP.from_row(self._report["subproblem"].copy()) if self.solver is not None else None

    @property
    def tip(self) -> Array:
        """(3,) where the last tick saw the tip [m]."""
        return self._report["tip"]

    @property
    def state(self) -> RobotState:
        """The model's state of the last tick, as far as the compiled tick computes it; NaN elsewhere."""
        return RobotState(self._known.take(self._in_state), self.robot.n)

    @property
    def external_torque(self) -> Array:
        """The observer's estimate of the external torque (n,) [Nm]; zero without an observer."""
        return self._state["external_torque"].copy()

    def terms(self) -> dict[str, NDArray[Any]]:
        """Copy the terms of the last tick, by name: mu, grad_mu, M ...; see `layout.layout`."""
        return {name: view.copy() for name, view in self._report.items()}

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the third level's columns; none but the status under DCAC."""
        n = self.robot.n
        found: dict[str, NDArray[Any]] = {
            "status": np.full(ticks, "none", dtype="<U12"),
            "solve_us": np.full(ticks, np.nan),
        }
        if self.solver is not None:
            # All in one row a tick: one copy a tick instead of one for each of these columns.
            self.reports = np.full((ticks, self._kept.size), np.nan)
            views = _views(self.reports, self._fields)
            found |= {
                "x_rad_per_s": np.full((ticks, n), np.nan), "dual": views["dual"],
                "applied_x_rad_per_s": views["x"], "subproblem": views["subproblem"],
                "iterations": np.zeros(ticks, dtype=np.int32), "fault": np.full(ticks, "none", dtype="<U12"),
            }  # fmt: skip
        return found

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the last tick's columns, those that ``columns`` gave last."""
        if self.solver is not None:
            self.reports[row] = self._kept
            self.took(np.array([self._status]), columns, row)

    def calling(self) -> AbstractContextManager[None]:
        """Return nothing that surrounds the call: see `control.called_tick.CalledTick`."""
        return nullcontext()

    def begin(self, columns: Mapping[str, NDArray[Any]], first: int) -> None:
        """Do nothing: see `control.called_tick.CalledTick`."""

    def took(self, returned: NDArray[np.int64], columns: Mapping[str, NDArray[Any]], first: int) -> None:
        """Note what ticks in compiled code returned (k,), whose reports are in rows from ``first`` on."""
        if returned.size == 0:
            return
        self._status = int(returned[-1])
        if self.solver is None:
            return
        rows, failed = slice(first, first + returned.size), returned != OK
        columns["status"][rows] = _LABELS[returned]
        columns["x_rad_per_s"][rows] = columns["applied_x_rad_per_s"][rows]
        if failed.any():
            bad = first + np.flatnonzero(failed)
            columns["x_rad_per_s"][bad] = columns["dual"][bad] = np.nan
            columns["fault"][bad] = np.where(returned[failed] == EMPTY, "infeasible", "failed")

    def _refusal(self) -> RobotError | ControlError:
        for name, value in (("q", self._q), ("v", self._v)):
            if not np.isfinite(value).all():
                return RobotError(f"{name} = {value.tolist()} is not finite: check the sensor or step that gave it")
        for name, reference in (("tip_ref", self._tip_ref), ("trocar", self._trocar)):
            if not np.isfinite(reference).all():
                return ControlError(f"{name} = {reference.tolist()} is not finite: check the reference")
        return ControlError(
            f"the torque at q = {self._q.tolist()} is not finite: the tip is in a singular pose, or a value is huge"
        )


@lru_cache(maxsize=8)
def _generated(pickled: bytes) -> tuple[Layout, dict[str, str]]:
    """Return layout and C files of (robot data, settings, solver, period): a law's second run need not write them."""
    data, settings, solver, period = pickle.loads(pickled)
    tick, texts = c_files(TickSpec(RobotModel(data), settings, solver, period))
    return tick.layout, texts


def _state_places(report: tuple[Field, ...], n: int) -> NDArray[np.intp]:
    """Place of each number of a state's record in (q, v, report, NaN); the NaN for numbers that the report lacks."""
    index = np.arange(record_size(n), dtype=np.float64)
    views = state_views.py_func(index, n)._asdict()
    length = sum(field.length for field in report)
    told = {"q": np.arange(n), "v": np.arange(n, 2 * n), **_named(np.arange(2 * n, 2 * n + length), report)}
    places = np.full(index.size, 2 * n + length, dtype=np.intp)
    for name in views.keys() & told.keys():
        places[views[name].ravel().astype(np.intp)] = told[name].ravel()
    return places


_LABELS = np.array([_STATUS[code].label for code in range(len(_STATUS))])


def _memory(fields: tuple[Field, ...]) -> tuple[Array, dict[str, NDArray[Any]]]:
    """Return the doubles of one of the header's structs, and a view of each member."""
    whole = np.zeros(sum(field.length for field in fields))
    return whole, _named(whole, fields)


def _named(whole: NDArray[Any], fields: tuple[Field, ...]) -> dict[str, NDArray[Any]]:
    """Return a view of each member of one of the structs."""
    return {name: view.reshape(view.shape[1:]) for name, view in _views(whole[None], fields).items()}


def _views(rows: NDArray[Any], fields: Sequence[Field]) -> dict[str, NDArray[Any]]:
    """Return a view (k, ...) of each member of the structs that are the k rows."""
    views, begin = {}, 0
    for field in fields:
        views[field.name] = rows[:, begin : begin + field.length].reshape(len(rows), *field.shape)
        begin += field.length
    return views
