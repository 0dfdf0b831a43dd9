"""What the adapters do beyond the conformance suite: why their settings are what they are, and what is no proof."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import qpsolvers

from moc_opt.errors import SolverError, UnknownNameError
from moc_opt.solvers import Status, create
from moc_opt.solvers.osqp import OSQP
from moc_opt.solvers.proxqp import ProxQP
from moc_opt.solvers.qpsolvers import ADVICE, QPSolver, reasons
from tests.problems import infeasible_problem, random_problem

HERE = sorted(qpsolvers.available_solvers)
every_library = pytest.mark.parametrize("library", HERE)


def solve(chosen, qp):
    return chosen.start(qp).solve(qp)


def problem(seed=0, **options):
    return random_problem(np.random.default_rng(seed), **options)


@pytest.mark.parametrize("adapter", [OSQP, ProxQP])
def test_another_shape_starts_another_workspace(adapter):
    rng = np.random.default_rng(6)
    session = adapter().start(random_problem(rng))
    for n in (9, 6, 7):
        qp = random_problem(rng, n, structured=False)
        found = session.solve(qp)
        assert found.status is Status.SOLVED
        assert qp.residuals(found.x, found.y).verified()


@pytest.mark.parametrize(("one", "other", "within"), [
    (OSQP(rows=5), OSQP(rows=6), 1e-4), (ProxQP(rows=5), ProxQP(rows=6), 1e-6),
    (ProxQP(box="bounds"), ProxQP(box="rows"), 1e-6),
    *((QPSolver(name, rows=5), QPSolver(name, rows=6, cost_scale=3e3), 2e-3) for name in HERE),
], ids=repr)  # fmt: skip
def test_both_forms_of_rows_and_box_give_the_same_answer(one, other, within):
    rng = np.random.default_rng(0)
    for _ in range(5):
        qp = random_problem(rng)
        found = [solve(chosen, qp) for chosen in (one, other)]
        assert found[0].status is found[1].status is Status.SOLVED
        np.testing.assert_allclose(found[0].x, found[1].x, atol=within)
        assert max(qp.residuals(s.x, s.y).natural for s in found) < 1e-5


@pytest.mark.parametrize(
    ("adapter", "values", "field"),
    [
        (OSQP, {"rows": 7}, "osqp: rows = 7"), (OSQP, {"rows": True}, "rows = True"),
        (OSQP, {"eps_rel": -1.0}, "eps_rel = -1.0"), (OSQP, {"max_iter": 1e4}, "max_iter = 10000.0"),
        (OSQP, {"check_termination": 0}, "check_termination = 0"), (OSQP, {"polishing": 1}, "polishing = 1"),
        (ProxQP, {"rows": "5"}, "proxqp: rows = '5'"), (ProxQP, {"box": "none"}, "box = 'none'"),
        (ProxQP, {"eps_primal_inf": 0}, "eps_primal_inf = 0"), (ProxQP, {"max_iter_in": -3}, "max_iter_in = -3"),
        (QPSolver, {"rows": 4}, "qpsolvers:daqp: rows = 4"), (QPSolver, {"cost_scale": 0.0}, "cost_scale = 0.0"),
        (QPSolver, {"options": 3}, "options = 3"), (QPSolver, {"advised": "no"}, "advised = 'no'"),
        (QPSolver, {"warm": None}, "warm = None"), (QPSolver, {"options": {"no_such": 1}}, "option 'no_such'"),
    ],
)  # fmt: skip
def test_bad_settings_are_named(adapter, values, field):
    with pytest.raises(SolverError, match=field):
        adapter("daqp", **values) if adapter is QPSolver else adapter(**values)


# --- OSQP ---


def test_the_library_as_it_comes_is_wrong_under_a_claim_of_success():
    """Why eps and cost_scale are what they are."""
    rng = np.random.default_rng(1)
    qps = [random_problem(rng) for _ in range(20)]
    plain = OSQP(eps=1e-3, eps_rel=1e-3, cost_scale=1.0)
    said = [(qp, solve(plain, qp)) for qp in qps]
    assert all(s.status is Status.SOLVED for _, s in said)
    assert sum(not qp.residuals(s.x).verified() for qp, s in said) > 10
    assert all(qp.residuals(solve(OSQP(), qp).x).verified() for qp in qps)


def test_running_out_of_iterations_is_not_solved():
    """One iteration short of its tolerance, OSQP calls the answer "solved inaccurate"."""
    qp = random_problem(np.random.default_rng(2))
    enough = solve(OSQP(check_termination=1), qp)
    assert enough.status is Status.SOLVED
    found = solve(OSQP(check_termination=1, max_iter=enough.iterations - 1), qp)
    assert found.status is Status.MAX_ITER
    assert found.iterations == enough.iterations - 1
    assert np.isfinite(found.x).all()


# --- ProxQP ---

COUNT = 100


def alternating(regularization=1e-5):
    """Feasible and infeasible problems in turn, each a jump away from the last."""
    rng = np.random.default_rng(1)
    makers = (random_problem, infeasible_problem)
    return [makers[i % 2](rng, regularization=regularization) for i in range(2 * COUNT)]


@pytest.mark.parametrize("regularization", [1e-5, 0.0])
@pytest.mark.parametrize("box", ["bounds", "rows"])
@pytest.mark.parametrize("rows", [5, 6])
def test_jumps_neither_fool_nor_stop_a_warm_session(rows, box, regularization):
    qps = alternating(regularization)
    session = ProxQP(rows=rows, box=box).start(qps[0])
    for feasible, qp in zip([True, False] * COUNT, qps, strict=True):
        found = session.solve(qp)
        assert found.status is (Status.SOLVED if feasible else Status.INFEASIBLE)
        if feasible:
            assert qp.residuals(found.x, found.y).verified(1e-7, 1e-4, 1e-4)
        else:
            assert np.isnan(found.x).all()


def test_jumps_between_feasible_problems_do_not_end_at_the_opposite_bound():
    """As they do with WARM_START_WITH_PREVIOUS_RESULT."""
    rng = np.random.default_rng(5)
    qps = [random_problem(rng, regularization=0.0) for _ in range(230)]
    sessions = [ProxQP(cost_scale=cost_scale).start(qps[0]) for cost_scale in (10.0, 1e3)]
    for qp in qps:
        for session in sessions:
            found = session.solve(qp)
            assert found.status is Status.SOLVED
            assert qp.residuals(found.x).loss < 1e-4


def test_proxqp_as_it_comes_calls_feasible_problems_infeasible():
    """Why eps_primal_inf and cost_scale are what they are."""
    plain = ProxQP(eps=1e-5, eps_primal_inf=1e-4, cost_scale=1.0)
    rng = np.random.default_rng(1)
    said = []
    for _ in range(40):
        qp = random_problem(rng, regularization=0.0)
        said.append(plain.start(qp).solve(qp).status)
    assert said.count(Status.INFEASIBLE) > 10


# --- qpsolvers ---


def test_reasons_name_what_is_here_and_what_is_not():
    found = reasons()
    assert {name for name, reason in found.items() if reason is None} == set(HERE)
    missing = {name: reason for name, reason in found.items() if reason is not None}
    assert "gurobi" in found
    assert all(f"pip install qpsolvers[{name}]" in reason for name, reason in missing.items())


def test_a_library_is_made_by_its_name():
    assert create(f"qpsolvers:{HERE[0]}", rows=6) == QPSolver(HERE[0], rows=6)
    with pytest.raises(UnknownNameError, match="qpsolvers: solver 'qadprog': did you mean 'quadprog'"):
        create("qpsolvers:qadprog")
    absent = next(name for name, reason in reasons().items() if reason is not None)
    with pytest.raises(SolverError, match=rf"'qpsolvers:{absent}' cannot run: .*pip install qpsolvers.{absent}"):
        create(f"qpsolvers:{absent}")


def test_options_reach_the_library():
    qp = problem(2)
    loose = QPSolver("osqp", options={"eps_abs": 1e-2, "eps_rel": 1e-2}).start(qp).solve(qp)
    tight = QPSolver("osqp").start(qp).solve(qp)
    assert qp.residuals(loose.x).primal > 1e-5 > qp.residuals(tight.x).primal
    short = QPSolver("osqp", options={"max_iter": 3}).start(qp).solve(qp)
    assert short.status is Status.MAX_ITER
    assert np.isnan(short.x).all()


def test_a_time_limit_is_told_from_a_failure():
    """Unscaled, HiGHS never ends on this problem; without the limit this test would not either."""
    qp = problem(3)
    chosen = QPSolver("highs", advised=False, options={"time_limit": 0.02})
    assert chosen.start(qp).solve(qp).status is Status.TIME_LIMIT
    assert "time_limit" in ADVICE["highs"].options


def test_only_a_status_certifies_infeasibility():
    qp = infeasible_problem(np.random.default_rng(4))
    said = {library: QPSolver(library).start(qp).solve(qp).status for library in HERE}
    proofs = {"clarabel", "osqp", "piqp", "proxqp", "quadprog", "scs"}
    assert {library for library, status in said.items() if status is Status.INFEASIBLE} == proofs & set(HERE)
    assert said["daqp"] is said["highs"] is Status.NUMERICAL


def test_quadprog_without_damping_is_unsupported():
    qp, chosen = problem(5, regularization=0.0), QPSolver("quadprog")
    assert "regularization > 0" in chosen.supports(qp)
    with pytest.raises(SolverError, match=r"quadprog: .*regularization > 0"):
        chosen.start(qp)
    assert chosen.supports(problem(5)) is None
    assert chosen.start(problem(5)).solve(qp).status is Status.UNSUPPORTED
    assert QPSolver("daqp").supports(qp) is None


@every_library
def test_no_warning_escapes(library):
    """qpsolvers warns of conversions and failures at every call; here the status says it."""
    good, bad = problem(7), infeasible_problem(np.random.default_rng(7))
    session = QPSolver(library, warm=True).start(good)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for qp in (good, good, bad):
            session.solve(qp)
