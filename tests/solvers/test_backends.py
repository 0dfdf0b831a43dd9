"""What the adapters do beyond the conformance suite: why their settings are what they are, and what is no proof."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import qpsolvers
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import MocOptError
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import Status
from moc_opt.solvers.library import Loader
from moc_opt.solvers.osqp import OSQP
from moc_opt.solvers.proxqp import ProxQP
from moc_opt.solvers.qpsolvers import ADVICE, QPSolver, reasons
from tests.problems import infeasible_problem, random_problem

HERE = sorted(qpsolvers.available_solvers)


def solve(chosen, qp):
    return chosen.start(qp).solve(qp)


def problem(seed=0, **options):
    return random_problem(np.random.default_rng(seed), **options)


def problems(seed, count, **options):
    rng = np.random.default_rng(seed)
    return [random_problem(rng, **options) for _ in range(count)]


@pytest.mark.parametrize(("one", "other", "within"), [
    (OSQP(rows=5), OSQP(rows=6), 1e-4), (ProxQP(rows=5), ProxQP(rows=6), 1e-6),
    *((QPSolver(name, rows=5), QPSolver(name, rows=6, cost_scale=3e3), 2e-3) for name in HERE),
], ids=repr)  # fmt: skip
def test_both_forms_of_rows_give_the_same_answer(one, other, within):
    for qp in problems(0, 5):
        a, b = solve(one, qp), solve(other, qp)
        assert a.status is b.status is Status.SOLVED
        np.testing.assert_allclose(a.x, b.x, atol=within)
        assert max(qp.residuals(s.x, s.y).natural for s in (a, b)) < 1e-5


# --- the buffers of the libraries ---


def buffers(m, n):
    """Views into stacked, padded and transposed arrays, as the libraries have them."""
    sides, columns = np.full((2, m + n + 1), np.nan), np.full((n, m + 2), np.nan)
    return {
        "P": np.full((n, n), np.nan).T, "packed": np.full(n * (n + 1) // 2, np.nan), "p": np.full(n, np.nan),
        "A": columns[:, :m].T, "low": sides[0, :m], "high": sides[1, :m], "lower": sides[0, m : m + n],
        "upper": sides[1, m : m + n],
    }, sides, columns  # fmt: skip


def untied(seed, n=7):
    """A subproblem whose six rows are independent."""
    J = np.random.default_rng(seed).normal(size=(2, 3, n))
    return NullSpaceQP(J[0], J[1], np.ones(3), np.zeros(3), np.ones(n), -np.ones(n), np.ones(n))


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000), n=st.sampled_from([6, 7, 9]), rows=st.sampled_from([5, 6]), tied=st.booleans(),
    scale=st.sampled_from([1.0, 1e3]), signs=st.tuples(*[st.sampled_from([1.0, -1.0])] * 3),
)  # fmt: skip
def test_every_number_is_where_it_belongs(seed, n, rows, tied, scale, signs):
    qp = problem(seed, n=n) if tied else untied(seed, n)
    m = rows if tied else 6  # what is not tied stays six rows
    arrays, sides, columns = buffers(m, n)
    load = Loader(rows, scale, signs=signs, **arrays)
    assert load(qp)
    A, b = (qp.reduced().A, qp.reduced().b) if m == 5 else (qp.A, qp.b)
    for name, expected in {
        "P": scale * qp.P, "p": signs[0] * scale * qp.p, "A": A, "low": b, "high": b, "lower": signs[1] * qp.lower,
        "upper": signs[2] * qp.upper,
    }.items():  # fmt: skip
        np.testing.assert_allclose(arrays[name], expected, rtol=1e-12, atol=1e-13 * scale)
    np.testing.assert_array_equal(arrays["packed"], [arrays["P"][i, j] for j in range(n) for i in range(j + 1)])
    assert np.isnan(sides[:, -1]).all()
    assert np.isnan(columns[:, m:]).all()
    y, five = np.arange(1.0, m + 1.0), qp.assembled(rows)
    np.testing.assert_allclose(load.lifted(y, 0.5), 0.5 * y @ five.lift, atol=1e-14)
    np.testing.assert_allclose(qp.A.T @ load.lifted(y, 2.0), 2.0 * five.A.T @ y, atol=1e-12)


# --- OSQP ---


def test_the_library_as_it_comes_is_wrong_under_a_claim_of_success():
    """Why eps and cost_scale are what they are."""
    qps, plain = problems(1, 20), OSQP(eps=1e-3, eps_rel=1e-3, cost_scale=1.0)
    said = [(qp, solve(plain, qp)) for qp in qps]
    assert all(s.status is Status.SOLVED for _, s in said)
    assert sum(not qp.residuals(s.x).verified() for qp, s in said) > 10
    assert all(qp.residuals(solve(OSQP(), qp).x).verified() for qp in qps)


def test_running_out_of_iterations_is_not_solved():
    """One iteration short of its tolerance, OSQP calls the answer "solved inaccurate"."""
    qp = problem(2)
    enough = solve(OSQP(check_termination=1), qp)
    short = solve(OSQP(check_termination=1, max_iter=enough.iterations - 1), qp)
    assert (enough.status, short.status) == (Status.SOLVED, Status.MAX_ITER)
    assert short.iterations == enough.iterations - 1
    assert np.isfinite(short.x).all()


# --- ProxQP ---


@pytest.mark.parametrize("regularization", [1e-5, 0.0])
@pytest.mark.parametrize("rows", [5, 6])
def test_jumps_neither_fool_nor_stop_a_warm_session(rows, regularization):
    """Feasible and infeasible problems in turn, each a jump away from the last."""
    rng, session = np.random.default_rng(1), ProxQP(rows=rows).start(problem())
    for k in range(80):
        qp = (infeasible_problem if k % 2 else random_problem)(rng, regularization=regularization)
        answer = session.solve(qp)
        assert answer.status is (Status.INFEASIBLE if k % 2 else Status.SOLVED)
        assert np.isnan(answer.x).all() if k % 2 else qp.residuals(*answer[:2]).verified(1e-7, 1e-4, 1e-4)


def test_jumps_between_feasible_problems_do_not_end_at_the_opposite_bound():
    """As they do with WARM_START_WITH_PREVIOUS_RESULT."""
    session = ProxQP(cost_scale=1e3).start(problem())
    for qp in problems(5, 230, regularization=0.0):
        answer = session.solve(qp)
        assert answer.status is Status.SOLVED
        assert qp.residuals(answer.x).loss < 1e-4


def test_proxqp_as_it_comes_calls_feasible_problems_infeasible():
    """Why eps_primal_inf and cost_scale are what they are."""
    plain = ProxQP(eps=1e-5, eps_primal_inf=1e-4, cost_scale=1.0)
    said = [solve(plain, qp).status for qp in problems(1, 40, regularization=0.0)]
    assert said.count(Status.INFEASIBLE) > 10


# --- qpsolvers ---


def test_reasons_name_what_is_here_and_what_is_not():
    known = reasons()
    assert {name for name, reason in known.items() if reason is None} == set(HERE)
    assert "gurobi" in known
    assert all(f"pip install qpsolvers[{name}]" in reason for name, reason in known.items() if reason is not None)


def test_options_reach_the_library():
    qp = problem(2)
    loose = solve(QPSolver("osqp", options={"eps_abs": 1e-2, "eps_rel": 1e-2}), qp)
    assert qp.residuals(loose.x).primal > 1e-5 > qp.residuals(solve(QPSolver("osqp"), qp).x).primal
    short = solve(QPSolver("osqp", options={"max_iter": 3}), qp)
    assert short.status is Status.MAX_ITER
    assert np.isnan(short.x).all()
    with pytest.raises(MocOptError, match="'no_such'"):
        QPSolver("daqp", options={"no_such": 1})


def test_a_time_limit_is_told_from_a_failure():
    """Unscaled, HiGHS never ends on this problem; without the limit this test would not either."""
    assert solve(QPSolver("highs", advised=False, options={"time_limit": 0.02}), problem(3)).status is Status.TIME_LIMIT
    assert "time_limit" in ADVICE["highs"].options


def test_only_a_status_certifies_infeasibility():
    qp = infeasible_problem(np.random.default_rng(4))
    said = {library: solve(QPSolver(library), qp).status for library in HERE}
    proofs = {"clarabel", "osqp", "piqp", "proxqp", "quadprog", "scs"}
    assert {library for library, status in said.items() if status is Status.INFEASIBLE} == proofs & set(HERE)
    assert said["daqp"] is said["highs"] is Status.NUMERICAL


@pytest.mark.parametrize("library", HERE)
def test_no_warning_escapes(library):
    """qpsolvers warns of conversions and failures at every call; here the status says it."""
    good, bad = problem(7), infeasible_problem(np.random.default_rng(7))
    session = QPSolver(library).start(good)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for qp in (good, good, bad):
            session.solve(qp)
