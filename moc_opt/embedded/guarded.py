"""The exported controller, compiled and called from Python, for comparison in tests and benchmarks."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.control import ControlSettings
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.embedded import program
from moc_opt.embedded.compiler import compile_library
from moc_opt.embedded.constants import DEFAULT_SAFETY_FILTER
from moc_opt.embedded.export import safe_files
from moc_opt.embedded.support import TickSpec
from moc_opt.errors import ControlError
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.solvers.base import Solver

FAULTS = ("none", "infeasible", "failed", "not_finite", "outside", "lied", "late")
"""Labels of the faults in moc_supervisor.h, in its order: those of `control.supervisor.Fault`."""
REASONS = (
    "", "not started", "the controller's state is damaged", "measurements not believed",
    "the wrench sensor's readings are no numbers", "the RCM error has been above",
    "the trocar's force has been above", "the tip has been", "the controller's torque is not finite",
    "measurements are more than", "all encoders repeat one reading", "the encoders' positions do not follow",
    "an encoder repeats one reading", "the measured motion is not what the torque makes",
    "the measurements are a recording", "one encoder repeats",
    "the wrench sensor repeats", "one encoder lags",
)  # fmt: skip
"""How the safety filter in Python begins the reasons to stop in moc_safe.h, in its order."""


class GuardedController:
    """The whole C controller of one arm: tick, supervisor, fallback and guard.

    Args:
        robot, settings, solver, period: as for `Controller`; only the solver ``exact`` can be compiled in.
        guard: the limits that are compiled in.

    Raises:
        ControlError: a setting that the C code cannot do; the message names it.
        CompilerError: no working C compiler here.
    """

    def __init__(
        self, robot: RobotModel, settings: ControlSettings, solver: Solver | None = None, period: float = 0.002,
        guard: SafetyFilterSettings = DEFAULT_SAFETY_FILTER,
    ) -> None:  # fmt: skip
        _, texts = safe_files(TickSpec(robot, settings, solver, period), guard)
        self._n = robot.n
        self.library = found = ctypes.PyDLL(str(compile_library(texts | program.read("access.c"))))
        found.moc_state_size.restype = ctypes.c_ulong
        self._state = ctypes.create_string_buffer(found.moc_state_size())
        self._has_clock = settings.supervisor.budget_us is not None
        self._reason = 0

    def start(self, q: ArrayLike, v: ArrayLike, applied: ArrayLike, stamp: int = 0) -> None:
        """Begin at measurement number ``stamp`` of q (n,) [rad], v (n,) [rad/s], ``applied`` (n,) [Nm] acting."""
        (q_at, v_at, applied_at), _kept = self._pointers(q, v, applied)
        number = ctypes.c_int64(stamp)
        self._reason = self.library.moc_safe_start(q_at, v_at, number, applied_at, self._state)

    def tick(
        self, q: ArrayLike, v: ArrayLike, tip_ref: ArrayLike, trocar: ArrayLike, wrench: ArrayLike,
        stamp: int, solve_us: float = 0.0,
    ) -> Array:  # fmt: skip
        """Compute the torque (n,) [Nm] of this period, within its limits; that of a damped stop once one was requested.

        Args:
            q, v: (n,) measured [rad], [rad/s].
            tip_ref, trocar: as for `Controller.tick`.
            wrench: (6,) force [N] and torque [Nm] of the tool on its mount, tool axes.
            stamp: number of the control period in which it was measured.
            solve_us: measured time of the solver, if it has a time budget.
        """
        if self._has_clock:
            ctypes.c_double.in_dll(self.library, "moc_solve_us").value = solve_us
        tau = np.empty(self._n)
        sizes = (self._n, self._n, 9, 6, 6)
        (q_at, v_at, *others), _kept = self._pointers(q, v, tip_ref, trocar, wrench, sizes=sizes)
        self._reason = self.library.moc_safe_step(
            q_at, v_at, ctypes.c_int64(stamp), *others, self._state, ctypes.c_void_p(tau.ctypes.data), None
        )
        return tau

    def hold(self, wrench: ArrayLike) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes in a stop, once a period; wrench (6,) as for ``tick``."""
        friction = np.empty(self._n)
        (at,), _kept = self._pointers(wrench, sizes=(6,))
        self.library.moc_safe_hold(at, self._state, ctypes.c_void_p(friction.ctypes.data))
        return friction

    @property
    def reason(self) -> str:
        """Why the arm has to be stopped; empty while it has not."""
        return REASONS[self._reason]

    @property
    def limited(self) -> int:
        """Joints at which the safety filter changed the last torque."""
        return int(self.library.moc_limited(self._state))

    @property
    def fault(self) -> str:
        """Label of the fault of the third level's last answer."""
        return FAULTS[self.library.moc_fault(self._state, -1)]

    def count(self, fault: str) -> int:
        """Return how often this fault occurred since the start."""
        return int(self.library.moc_fault(self._state, FAULTS.index(fault)))

    @property
    def warned(self) -> list[tuple[int, float]]:
        """Of RCM error [m] and trocar force [N]: first tick above the warning level (-1: none), and the largest."""
        largest, first = (ctypes.c_double * 2)(), (ctypes.c_int * 2)()
        self.library.moc_incision_seen(self._state, largest, first)
        return list(zip(first, largest, strict=True))

    @property
    def remembered(self) -> Array:
        """(14 + 14 n,) what is remembered from tick to tick, as access.c lists it."""
        out = np.empty(14 + 14 * self._n)
        self.library.moc_remembered(self._state, ctypes.c_void_p(out.ctypes.data))
        return out

    def _pointers(
        self, *given: ArrayLike, sizes: tuple[int, ...] | None = None
    ) -> tuple[list[ctypes.c_void_p], list[Array]]:
        """Return the addresses of flat copies, and the copies, which have to live as long."""
        arrays = [np.ascontiguousarray(values, dtype=np.float64).ravel() for values in given]
        for array, size in zip(arrays, sizes or (self._n,) * len(arrays), strict=True):
            if array.size != size:
                raise ControlError(f"an array of {array.size} numbers where the C code reads {size}: give {size}")
        return [ctypes.c_void_p(array.ctypes.data) for array in arrays], arrays
