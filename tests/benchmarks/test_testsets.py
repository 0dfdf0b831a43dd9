"""Test sets of subproblems with certified optima."""

import subprocess
import sys
from fractions import Fraction
from importlib.util import find_spec

import numpy as np
import polars as pl
import pytest
from scipy.optimize import linprog

from benchmarks import certify, export, testsets
from benchmarks.certify import certified, five_rows, optimum
from moc_opt.arrays import Array
from moc_opt.qp.problem import NullSpaceQP, compute_residuals
from moc_opt.solvers import create
from moc_opt.study.testsets import NAMES, CertificateError, TestSet, changed, five_row_gap, straightened


def found(A: Array, b: Array, pull: Array, rho: float, lower: Array, upper: Array) -> list[float] | None:
    exact = optimum(np.array(A, float), np.array(b), [Fraction(p) for p in pull], rho, np.array(lower), np.array(upper))
    return None if exact is None else [float(value) for value in exact]


TWICE, UNIT = [[1.0, 1.0], [2.0, 2.0]], ([0.0, 0.0], [1.0, 1.0])
ALONE, LONG = [[1.0, 0.0]], ([0.0, -1.0], [1.0, 2.0])


@pytest.mark.parametrize(("A", "b", "pull", "rho", "box", "expected"), [
    (TWICE, [1.0, 2.0], [1.0, 0.0], 0.0, UNIT, [1.0, 0.0]),  # repeated rows
    (TWICE, [1.0, 2.0 + 1e-15], [1.0, 0.0], 0.0, UNIT, None),  # contradictory rows
    (ALONE, [0.5], [0.0, 0.0], 0.0, LONG, [0.5, 0.0]),  # joint 2 is in no row
    (ALONE, [0.5], [0.0, 1.0], 0.0, LONG, [0.5, 2.0]), (ALONE, [0.5], [0.0, -1.0], 0.0, LONG, [0.5, -1.0]),
    (ALONE, [0.5], [0.0, 3.0], 2.0, LONG, [0.5, 1.5]), (ALONE, [0.5], [0.0, -3.0], 2.0, LONG, [0.5, -1.0]),
])  # fmt: skip
def test_enumeration_of_active_bounds_finds_known_optima(A, b, pull, rho, box, expected):
    assert found(A, b, pull, rho, *box) == expected


@pytest.mark.parametrize("rho", [0.0, 0.3])
@pytest.mark.parametrize("rows", [5, 4, 3, 2])
def test_highs_finds_no_better_point(rows, rho):
    """A point is optimal if HiGHS cannot lower the linearized cost."""
    rng = np.random.default_rng([rows, int(10 * rho)])
    A, pull, upper = rng.normal(size=(rows, 6)), rng.normal(size=6), rng.uniform(0.1, 1.0, 6)
    b = A @ rng.uniform(-upper, upper)
    x = np.array(found(A, b, pull, rho, -upper, upper))
    assert descent(A, b, rho * x - pull, -upper, upper, x) < 1e-9


def descent(A: Array, b: Array, slope: Array, lower: Array, upper: Array, x: Array) -> float:
    """Return the decrease of slope^T x that HiGHS finds, divided by |slope|_inf."""
    np.testing.assert_allclose(A @ x, b, atol=1e-12)
    assert (np.maximum(lower - x, x - upper) <= 1e-15).all()
    unit = slope / (np.abs(slope).max() or 1.0)
    best = linprog(unit, A_eq=A, b_eq=b, bounds=list(zip(lower, upper, strict=True)), method="highs")
    assert best.status == 0
    return float(unit @ x - best.fun)


@pytest.mark.parametrize("name", NAMES)
def test_shipped_answers_are_certified_optima(name):
    kept = TestSet.load(name)
    assert kept.rows.shape[0] == kept.x.shape[0] == kept.feasible.size > 0
    assert compute_residuals(kept.judged, kept.x).verified(primal=1e-9)[kept.feasible].all()
    assert not compute_residuals(kept.judged, kept.x + 0.05).verified()[kept.feasible].any()
    assert np.isnan(kept.x[~kept.feasible]).all()
    few = kept.thinned(16)
    np.testing.assert_array_equal(few.judged, TestSet(name, few.rows, few.x, few.feasible).judged)
    again = certify.certify(name, [NullSpaceQP.from_row(np.array(row)) for row in kept.rows[::16]])
    np.testing.assert_array_equal(again.feasible, kept.feasible[::16])
    np.testing.assert_allclose(again.x, kept.x[::16], atol=1e-9)
    for qp, x in zip(again.problems(), again.x, strict=True):
        A, b = five_rows(qp)
        if np.isfinite(x).all() and np.linalg.svd(A)[1][-1] > 1e-6:  # HiGHS meets A x = b only to 1e-7
            slope = qp.regularization * x - qp.c2 * qp.grad_mu
            assert descent(A, b, slope, qp.lower, qp.upper, x) < 1e-6


def test_problem_that_cannot_be_certified_is_refused(monkeypatch):
    infeasible = TestSet.load("infeasible")
    unsolved = infeasible.problems()[int(np.argmin(infeasible.feasible))]
    for qp, answer in ((TestSet.load("circle").problems()[0], None), (unsolved, [Fraction(0)] * 7)):
        monkeypatch.setattr(certify, "certified", lambda _, answer=answer: answer)
        with pytest.raises(CertificateError):  # HiGHS contradicts the answer
            certify.certify("wrong", [qp])
    with pytest.raises(CertificateError):  # tip and wrist are not rigidly connected
        certified(changed(unsolved, J_wrist=2.0 * unsolved.J_wrist))


@pytest.mark.parametrize("name", ["random", "joint-limits", "jumps", "inconsistent-1e-6"])
def test_sets_are_reproducible(name, robot):
    made, kept = testsets.make(name, robot), TestSet.load(name)
    np.testing.assert_allclose(made.rows, kept.rows, rtol=1e-9, atol=1e-12, equal_nan=True)
    np.testing.assert_array_equal(made.feasible, kept.feasible)


def test_inconsistent_velocities_of_tip_and_wrist_differ_along_the_shaft():
    for power in (-12, -8, -4):
        for qp in TestSet.load(f"inconsistent-1e{power}").problems()[:8]:
            assert np.linalg.norm(five_row_gap(qp, qp.b)) == pytest.approx(10.0**power, rel=1e-2)
            straight = straightened(qp)
            assert np.linalg.norm(five_row_gap(straight, straight.b)) < 1e-15
            np.testing.assert_allclose(straight.reduced().b, qp.reduced().b, atol=1e-15)


@pytest.mark.skipif(find_spec("qpbenchmark") is None, reason="pip install '.[qpbenchmark]'")
def test_qpbenchmark_runs_exported_sets(tmp_path):
    from qpbenchmark.benchmark import load_test_set

    assert export.main(["qpbenchmark", "--out", str(tmp_path), "--sets", "circle", "random", "--every", "64"]) == 0
    module, written = tmp_path / "null_space.py", export.problems(["circle", "random"], 64)
    sys.modules.pop("null_space", None)
    read = {problem.name: problem for problem in load_test_set(str(module))}
    for name, qp in written.items():
        np.testing.assert_array_equal(read[name].P, qp.P)
        np.testing.assert_array_equal(read[name].A, qp.reduced().A)
        np.testing.assert_array_equal(read[name].lb, qp.lower)
        assert read[name].G is None
    results = tmp_path / "results.csv"
    command = [sys.executable, "-m", "qpbenchmark.benchmark", str(module), "--results-path", str(results)]
    subprocess.run([*command, "run", "--author", "me", "--solver", "daqp"], check=True, capture_output=True)
    rows = pl.read_csv(results)
    assert len(rows) == 4 * len(written)  # qpbenchmark runs each problem under four settings
    assert rows.filter(pl.col("settings") == "high_accuracy")["found"].all()


def test_only_feasible_problems_are_exported():
    chosen = export.problems(["infeasible"], 1)
    session = create("exact").start(next(iter(chosen.values())))
    assert 0 < len(chosen) < 128
    assert all(session.solve(qp).status.label == "solved" for qp in chosen.values())
    assert all(name.isidentifier() for name in chosen)
