"""Solvers from strangers: their answers, exceptions, and changes of the interpreter in which the loop runs."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import hypothesis.strategies as st
import numpy as np

from benchmarks.reliability.fuzz_case import Kind, Verdict, Wrong
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP, fields
from moc_opt.scenario import Scenario, Setup
from moc_opt.solvers.base import Session, Solution, Status
from moc_opt.solvers.exact.solver import Exact
from moc_opt.trace.trace import Trace

Deed = Callable[[], Any]

_libm = ctypes.CDLL(None)
_IS_X86 = os.uname().machine == "x86_64"
_UPWARD = 0x800 if _IS_X86 else 0x400000  # fenv.h
TICKS = 30


def _nothing(*arguments: Any) -> None:
    """Do nothing, as a handler or a tracing function."""


def _flush_to_zero() -> None:
    environment = (ctypes.c_uint32 * 16)()
    _libm.fegetenv(environment)
    environment[7] |= 0x8040  # MXCSR: results and operands below 1e-308 become zero
    _libm.fesetenv(environment)


def _alarm() -> None:
    signal.signal(signal.SIGALRM, _nothing)
    signal.setitimer(signal.ITIMER_REAL, 1e-3, 1e-3)


def _stack() -> int:
    frame, depth = sys._getframe(), 0
    while frame.f_back is not None:
        frame, depth = frame.f_back, depth + 1
    return depth


MEDDLING: Mapping[str, Deed] = {
    "ctrl-c": lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    "ctrl-c, in C": lambda: _libm.signal(int(signal.SIGINT), ctypes.c_void_p(1)),
    "terminate": lambda: signal.signal(signal.SIGTERM, _nothing),
    "blocked": lambda: signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]),
    "trace": lambda: sys.settrace(_nothing),
    "profile": lambda: sys.setprofile(_nothing),
    "numpy": lambda: np.seterr(all="raise"),
    "rounding": lambda: _libm.fesetround(_UPWARD),
    "recursion": lambda: sys.setrecursionlimit(_stack() + 60),
    "switch": lambda: sys.setswitchinterval(100.0),
    "warnings": lambda: warnings.simplefilter("error"),
    "stdout": lambda: setattr(sys, "stdout", None),
    "stderr": lambda: setattr(sys, "stderr", None),
    "excepthook": lambda: setattr(sys, "excepthook", _nothing),
    "folder": lambda: os.chdir("/"),
    "mask": lambda: os.umask(0o777),
    "alarm": _alarm,
    **({"flush to zero": _flush_to_zero} if _IS_X86 else {}),
}  # fmt: skip
"""Changes of the interpreter that a solver may make, each by its name."""


def as_it_is() -> dict[str, Any]:
    """Return all that `MEDDLING` changes, as it shows from outside."""
    mask = os.umask(0)
    os.umask(mask)
    with open("/proc/self/status", encoding="ascii") as file:  # the system's own table of handlers, also of those in C
        signals = [line for line in file if line.startswith(("SigBlk", "SigIgn", "SigCgt"))]
    small = (2.0**-53, 2.0**-1074)
    return {
        "signals": signals, "handlers": [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)],
        "trace": sys.gettrace(), "profile": sys.getprofile(), "numpy": np.geterr(),
        "rounding": (1.0 + small[0], 1.0 * small[1]), "depth": sys.getrecursionlimit(),
        "switch": sys.getswitchinterval(), "warnings": list(warnings.filters), "folder": os.getcwd(), "mask": mask,
        "timer": signal.getitimer(signal.ITIMER_REAL)[1], "streams": (sys.stdout, sys.stderr, sys.excepthook),
    }  # fmt: skip


class _Odd(np.int64):
    """A count that lies about its size, but not to ``int``."""

    def __le__(self, other: object) -> bool:  # type: ignore[override]
        return True

    def __ge__(self, other: object) -> bool:  # type: ignore[override]
        return True

    def __int__(self) -> int:
        return 2**70


class _Unsayable(Exception):
    def __str__(self) -> str:
        raise SystemExit(3)


ANSWERS: Mapping[str, Callable[[NullSpaceQP, Solution], Any]] = {
    "none": lambda qp, good: None,
    "a tuple": lambda qp, good: tuple(good),
    "a count that lies": lambda qp, good: Solution(good.x, good.y, good.status, _Odd(3)),  # type: ignore[arg-type]
    "a matrix": lambda qp, good: good._replace(x=good.x[None]),
    "objects": lambda qp, good: good._replace(x=good.x.astype(object)),
    "strides": lambda qp, good: good._replace(x=np.repeat(good.x, 2)[::2]),
    "swapped bytes": lambda qp, good: good._replace(x=good.x.astype(">f8")),
    "huge": lambda qp, good: good._replace(x=np.full(qp.n, 1e308)),
    "infinite": lambda qp, good: good._replace(x=np.full(qp.n, -np.inf)),
    "a text as status": lambda qp, good: Solution(good.x, None, "solved"),  # type: ignore[arg-type]
    "the upper bound": lambda qp, good: good._replace(x=qp.upper.copy()),
    "no self-motion": lambda qp, good: good._replace(x=np.linalg.lstsq(qp.A, qp.b, rcond=None)[0]),
    "solved and infeasible": lambda qp, good: good._replace(status=Status.INFEASIBLE),
}  # fmt: skip
"""Objects returned in place of a good answer."""

RAISED: tuple[Callable[[], BaseException], ...] = (
    lambda: SystemExit(0), lambda: GeneratorExit(), lambda: StopIteration(), lambda: MemoryError(), _Unsayable,
    lambda: BaseExceptionGroup("several", [SystemExit(), KeyboardInterrupt()]), lambda: RecursionError("\x1b[2J" * 999),
)  # fmt: skip

deeds = st.one_of(
    st.sampled_from(sorted(MEDDLING)), st.sampled_from(sorted(ANSWERS)), st.integers(0, len(RAISED) - 1),
    st.just("write"), st.just("keep"),
)  # fmt: skip
solvers = st.dictionaries(st.integers(1, TICKS), deeds, min_size=1, max_size=6)
"""At which answer (0: when it is started) what is done."""


class Hostile:
    """The exact solver, which also does something else."""

    name = "hostile"

    def __init__(self, deeds: Mapping[int, str | int]) -> None:
        self.deeds = deeds

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None: it takes every problem."""
        return None

    def start(self, qp: NullSpaceQP) -> Session:
        """Start the session."""
        return _Session(self.deeds, Exact().start(qp))


class _Session:
    def __init__(self, deeds: Mapping[int, str | int], inner: Session) -> None:
        self._deeds, self._inner, self._asked = deeds, inner, 0
        self._kept: list[Array] = []

    def solve(self, qp: NullSpaceQP) -> Any:
        """Answer one subproblem in some way."""
        self._asked += 1
        for row in self._kept:  # of ticks before: what was handed over then is written over now
            row.setflags(write=True)
            row[:] = np.nan
        good, deed = self._inner.solve(qp), self._deeds.get(self._asked)
        if deed == "keep":
            self._kept += [qp.row, good.x]
        elif deed == "write":
            qp.row.setflags(write=True)
            fields(qp.row).A[:] = np.nan
        elif isinstance(deed, int):
            raise RAISED[deed]()
        elif deed is not None and deed in MEDDLING:
            MEDDLING[deed]()
        elif deed is not None:
            return ANSWERS[deed](qp, good)
        return good


@cache
def _scenario() -> tuple[Scenario, Trace]:
    scenario = Scenario(duration_s=0.002 * TICKS, bound_samples=0, judge=False)
    return scenario, Setup(scenario).trace()


def hostile_solver(deeds: Mapping[int, str | int]) -> Verdict:
    """Check a run with a hostile solver: "accepted" where it changed no torque, "refused" where it was replaced.

    Raises:
        Wrong: the run ended in another way, an answer that was no good one was followed, or the interpreter is not
            what it was.
    """
    scenario, honest = _scenario()
    setup, before = Setup(scenario, Hostile(deeds)), as_it_is()
    trace = setup.trace()
    changed = [name for name, value in as_it_is().items() if value != before[name]]
    if changed:
        raise Wrong(f"the run leaves the interpreter with other {changed}")
    if trace.meta["ended"] != "completed":
        raise Wrong(f"ended: {trace.meta['ended']}")
    lies = {k for k, deed in deeds.items() if isinstance(deed, int) or (deed in ANSWERS and deed != "strides")}
    if set(np.flatnonzero(trace.fault != "none") + 1) != lies:
        raise Wrong(f"faults at {np.flatnonzero(trace.fault != 'none') + 1}, and not at {sorted(lies)}")
    first = min(lies, default=TICKS + 1) - 1
    rounded = min((k for k, deed in deeds.items() if deed == "rounding"), default=TICKS + 1)
    if not np.array_equal(trace.tau_Nm[: min(first, rounded - 1)], honest.tau_Nm[: min(first, rounded - 1)]):
        raise Wrong("a torque is not that of the honest solver")
    if not (np.abs(trace.tau_Nm) <= setup.robot.tau_max).all():
        raise Wrong("a torque is beyond its limit")
    return "refused" if lies else "accepted"


KINDS = {"hostile_solver": Kind(hostile_solver, solvers)}
