"""What must be true of any input: it works, or it is refused with a MocOptError that says what is wrong.

Each check takes one input. It returns "accepted" or "refused"; it raises when neither is the case.
"""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import numpy as np

from benchmarks.reliability.fuzz_c import exported
from benchmarks.reliability.fuzz_inputs import good_trace
from moc_opt.control.null_space import null_space
from moc_opt.control.solution_check import answer_residuals
from moc_opt.errors import MocOptError, SubproblemError
from moc_opt.model.robot_model import load_robot
from moc_opt.qp.problem import NullSpaceQP, compute_residuals
from moc_opt.scenario import Scenario, run
from moc_opt.scenario.agreement import check_engines
from moc_opt.sim.plant import Plant
from moc_opt.solvers import create
from moc_opt.solvers.base import Status
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

__all__ = [
    "exported", "record_file", "result_file", "robot_file", "scenario", "scenario_file", "subproblem", "warm_up",
]  # fmt: skip

Verdict = Literal["accepted", "refused"]
LIMIT_S = 20


class Hang(BaseException):
    """A case took too long. No Exception: nothing may swallow it."""


class Wrong(AssertionError):
    """An input was taken, and what came of it is not true; or refused without saying why."""


@contextmanager
def time_limit(seconds: int = LIMIT_S) -> Iterator[None]:
    """Raise Hang where the inside takes longer."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise Hang(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def warm_up() -> None:
    """Compile what is compiled: a compiler at work looks like a hang."""
    for law in ("moc", "dcac"):
        trace = run(Scenario(control={"law": law}, duration_s=0.004, bound_samples=1))
    qp = NullSpaceQP(
        np.eye(3, 7), np.eye(3, 7), np.zeros(3), np.zeros(3), np.ones(7), -np.ones(7), np.ones(7)
    )
    for name in ("exact", "rnn"):
        solver = create(name)
        solver.start(qp).solve(qp)
    summarize(trace)


def scenario(case: tuple[dict[str, Any], tuple[str, ...]]) -> Verdict:
    """A scenario as a table: two ticks of it run."""
    table, names = case
    try:
        made = Scenario(**table)
    except MocOptError as error:
        if not any(repr(name)[1:-1] in str(error) for name in names):
            raise Wrong(f"none of {names} is named: {error}") from error
        return "refused"
    return few_ticks(made)


def scenario_file(data: bytes) -> Verdict:
    """A scenario's file."""
    with _file(data, "scenario.toml") as path:
        try:
            made = Scenario.load(path)
        except MocOptError as error:
            if path.name not in str(error):
                raise Wrong(f"the file is not named: {error}") from error
            return "refused"
    return few_ticks(made)


def few_ticks(made: Scenario) -> Verdict:
    """Two ticks of a scenario, sound or refused."""
    try:
        short = made.change(duration_s=2.0 * made.plant.period_s, bound_samples=min(made.bound_samples, 2))
        trace = run(short)
    except MocOptError as error:
        if len(str(error)) < 15:
            raise Wrong(f"says too little: {error}") from error
        return "refused"
    if not (np.isfinite(trace.q_rad).all() and np.isfinite(trace.tau_Nm).all()):
        raise Wrong("a run that ended well holds NaN")
    summarize(trace)
    return "accepted"


def robot_file(case: tuple[bytes, bytes]) -> Verdict:
    """An arm's TOML and URDF: loaded, modelled, and two periods in the plant."""
    with _file(case[0], "arm.toml") as path:
        path.with_suffix(".urdf").write_bytes(case[1])
        try:
            robot = load_robot(path)
            check_engines(robot)
            state = robot.state(robot.data.q_home)
            plant = Plant(robot.data)
            for _ in range(2):
                plant.step(robot.gravity(robot.data.q_home))
        except MocOptError as error:
            if len(str(error)) < 15:
                raise Wrong(f"says too little: {error}") from error
            return "refused"
    for name in ("tip", "wrist", "M", "h"):
        if not np.isfinite(getattr(state, name)).all():
            raise Wrong(f"{name} of an arm that was accepted is not finite")
    if np.linalg.eigvalsh(state.M).min() <= 0.0:
        raise Wrong("the inertia of an arm that was accepted is not positive definite")
    return "accepted"


def subproblem(case: dict[str, Any]) -> Verdict:
    """A subproblem: built, and answered by two solvers that are ours."""
    try:
        qp = NullSpaceQP(**case)
    except SubproblemError as error:
        if not any(name in str(error) for name in case):
            raise Wrong(f"no field is named: {error}") from error
        return "refused"
    with np.errstate(all="ignore"):  # numbers of 1e300 overflow; what counts is what is said about them
        for name in ("exact", "rnn"):
            solver = create(name)
            if solver.supports(qp) is not None:
                continue
            found = solver.start(qp).solve(qp)
            if found.x.shape != (qp.n,) or not isinstance(found.status, Status):
                raise Wrong(f"{name}: no Solution: {found}")
            if found.status is not Status.SOLVED:
                continue
            if not np.isfinite(found.x).all():
                raise Wrong(f"{name}: claims success for {found.x}")
            _claim(qp, name, found.x)
    return "accepted"


def _claim(qp: NullSpaceQP, name: str, x: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    """A claim on numbers of ordinary size must be true."""
    part = qp.fields
    largest = max(
        float(np.abs(a).max(initial=0.0)) for a in (part.A, part.b, part.lower, part.upper, part.grad_mu)
    )
    smallest = np.linalg.svd(part.A, compute_uv=False)
    rank = smallest > 1e-9 * smallest[0]
    if largest > 1e3 or not rank.any() or (smallest[rank].min() < 1e-3 * smallest[0]):
        return  # ill-conditioned: a residual of rounding errors is no wrong claim
    if 0.0 < part.weights[2] * np.abs(part.grad_mu).max() < 1e-9:
        return
    found = compute_residuals(qp.row[None], x[None])
    # A loss is a share of the way that the box leaves, which may be one of rounding errors: only ways count.
    off = answer_residuals(qp.row, qp.n, null_space(part.A), x)[3]
    if found.primal[0] > 1e-6 or (found.loss[0] > 1e-2 and off > 1e-9):
        raise Wrong(f"{name}: claims success with primal {found.primal[0]:.1e}, loss {found.loss[0]:.1e}")


def result_file(data: bytes) -> Verdict:
    """A trace's Parquet file: the trace that was saved, or a refusal; and what is in it is data only."""
    with _file(data, "trace.parquet") as path:
        try:
            found = Trace.load(path)
        except MocOptError as error:
            if path.name not in str(error) and "column" not in str(error) and "meta" not in str(error):
                raise Wrong(f"neither file nor column is named: {error}") from error
            return "refused"
    for name, column in found.columns.items():
        if column.dtype.kind not in "fiubU":
            raise Wrong(f"column {name!r} is {column.dtype}")
    original = good_trace()[0]
    if set(found.columns) == set(original.columns):
        for name, column in original.columns.items():
            if not np.array_equal(found.columns[name], column):
                raise Wrong(f"column {name!r} is not what was saved")
    try:
        summarize(found)
    except MocOptError:
        return "refused"
    return "accepted"


def record_file(data: bytes) -> Verdict:
    """A sweep's record (JSON): what was sealed, or nothing."""
    from benchmarks.sweeps.store import _opened

    with _file(data, "record.json") as path:
        found = _opened(path, "0")
    if found is not None and not isinstance(found, dict):
        raise Wrong(f"a record that is a {type(found).__name__}")
    return "refused" if found is None else "accepted"


@contextmanager
def _file(data: bytes, name: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="moc-opt-fuzz-") as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        yield path


Check = Callable[[Any], Verdict]
