"""What must be true of scenarios, robots, subproblems and results from strangers; see `fuzz_case`."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from benchmarks.reliability import fuzz_c
from benchmarks.reliability.fuzz_case import Kind, Verdict, Wrong, arm, file, refused
from benchmarks.reliability.fuzz_inputs import TOML, edited, record_files, robot_files, scenarios, subproblems
from benchmarks.reliability.fuzz_traces import footers, good_trace, result_files
from benchmarks.sweeps.record import opened
from moc_opt.control.null_space import null_space
from moc_opt.control.solution_check import answer_residuals
from moc_opt.errors import MocOptError, SubproblemError
from moc_opt.inputs.parquet_footer import demand_of
from moc_opt.model.robot_model import load_robot
from moc_opt.qp.problem import NullSpaceQP, compute_residuals
from moc_opt.scenario import Scenario, run
from moc_opt.scenario.agreement import check_engines
from moc_opt.sim.plant import Plant
from moc_opt.solvers import create
from moc_opt.solvers.base import Status
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace


def warm_up() -> None:
    """Compile what is compiled: a compiler at work looks like a hang."""
    for law in ("moc", "dcac"):
        trace = run(Scenario(control={"law": law}, duration_s=0.004, bound_samples=1))
    rows, rest = np.eye(3, 7), np.zeros(3)
    qp = NullSpaceQP(rows, rows, rest, rest, np.ones(7), lower=-np.ones(7), upper=np.ones(7))
    for name in ("exact", "rnn"):
        solver = create(name)
        solver.start(qp).solve(qp)
    summarize(trace)


def scenario(case: tuple[dict[str, Any], tuple[str, ...]]) -> Verdict:
    """Check a scenario as a table: two ticks of it run."""
    table, names = case
    try:
        made = Scenario(**table)
    except MocOptError as error:
        return refused(error, any(repr(name)[1:-1] in str(error) for name in names))
    return few_ticks(made)


def scenario_file(data: bytes) -> Verdict:
    """Check a scenario's file."""
    with file("scenario.toml", data) as path:
        try:
            made = Scenario.load(path)
        except MocOptError as error:
            return refused(error, path.name in str(error))
    return few_ticks(made)


def few_ticks(made: Scenario) -> Verdict:
    """Check two ticks of a scenario, sound or refused."""
    try:
        short = made.change(duration_s=2.0 * made.plant.period_s, bound_samples=min(made.bound_samples, 2))
        trace = run(short)
    except MocOptError as error:
        return refused(error)
    if not (np.isfinite(trace.q_rad).all() and np.isfinite(trace.tau_Nm).all()):
        raise Wrong("a run that ended well holds NaN")
    summarize(trace)
    return "accepted"


def robot_file(case: tuple[bytes, bytes]) -> Verdict:
    """Check an arm's TOML and URDF: loaded, modelled, and two periods in the plant."""
    with arm(*case) as path:
        try:
            robot = load_robot(path)
            check_engines(robot)
            state = robot.state(robot.data.q_home)
            plant = Plant(robot.data)
            for _ in range(2):
                plant.step(robot.gravity(robot.data.q_home))
        except MocOptError as error:
            return refused(error)
    for name in ("tip", "wrist", "M", "h"):
        if not np.isfinite(getattr(state, name)).all():
            raise Wrong(f"{name} of an arm that was accepted is not finite")
    if np.linalg.eigvalsh(state.M).min() <= 0.0:
        raise Wrong("the inertia of an arm that was accepted is not positive definite")
    return "accepted"


def subproblem(case: dict[str, Any]) -> Verdict:
    """Check a subproblem: built, and answered by two solvers that are ours."""
    try:
        qp = NullSpaceQP(**case)
    except SubproblemError as error:
        return refused(error, any(name in str(error) for name in case))
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
    """Check that a claim on numbers of ordinary size is true."""
    part = qp.fields
    largest = max(float(np.abs(a).max(initial=0.0)) for a in (part.A, part.b, part.lower, part.upper, part.grad_mu))
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
    """Check a trace's Parquet file: the trace that was saved, or a refusal; and what is in it is data only."""
    with file("trace.parquet", data) as path:
        try:
            found = Trace.load(path)
        except MocOptError as error:
            return refused(error, any(name in str(error) for name in (path.name, "column", "meta")))
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


def parquet_footer(data: bytes) -> Verdict:
    """Check a Parquet file with a damaged footer: read or refused; no library ends the process."""
    with file("trace.parquet", data) as path:
        try:
            found = Trace.load(path)
        except MocOptError as error:
            return refused(error, any(name in str(error) for name in (path.name, "column", "meta")))
    asked = demand_of(io.BytesIO(data), 2**26)
    if {len(column) for column in found.columns.values()} != {asked.rows} or asked.columns < len(found.columns):
        raise Wrong(f"a trace of other rows or columns than its footer's: {asked}")
    return "accepted"


def record_file(data: bytes) -> Verdict:
    """Check a sweep's record (JSON): what was sealed, or nothing."""
    with file("record.json", data) as path:
        found = opened(path, "0")
    if found is not None and not isinstance(found, dict):
        raise Wrong(f"a record that is a {type(found).__name__}")
    return "refused" if found is None else "accepted"


KINDS = {
    "scenario": Kind(scenario, scenarios()), "scenario_file": Kind(scenario_file, edited(TOML)),
    "robot_file": Kind(robot_file, robot_files()), "subproblem": Kind(subproblem, subproblems()),
    "result_file": Kind(result_file, result_files()), "record_file": Kind(record_file, record_files),
    "parquet_footer": Kind(parquet_footer, footers()),
    "exported": Kind(fuzz_c.exported, fuzz_c.cases),
}  # fmt: skip
