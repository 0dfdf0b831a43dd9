"""The qpsolvers bridge: settings reach the library, and its silence is not taken for a proof."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest
import qpsolvers

from moc_opt.errors import SolverError, UnknownNameError
from moc_opt.solvers import Status, create
from moc_opt.solvers.backends.qpsolvers import ADVICE, QPSolver, reasons
from moc_opt.solvers.options import ALLOWED
from moc_opt.solvers.registry import defaults
from tests.problems import infeasible_problem, random_problem, smooth_sequence

HERE = sorted(qpsolvers.available_solvers)
every_library = pytest.mark.parametrize("library", HERE)


def problem(seed=0, **options):
    return random_problem(np.random.default_rng(seed), **options)


def test_reasons_name_what_is_here_and_what_is_not():
    found = reasons()
    assert {name for name, reason in found.items() if reason is None} == set(HERE)
    missing = {name: reason for name, reason in found.items() if reason is not None}
    assert "gurobi" in found
    assert all(f"pip install qpsolvers[{name}]" in reason for name, reason in missing.items())


def test_a_library_is_made_by_its_name():
    assert set(defaults(f"qpsolvers:{HERE[0]}")) == {"rows", "cost_scale", "options", "advised", "warm"}
    assert create(f"qpsolvers:{HERE[0]}", rows=6) == QPSolver(HERE[0], rows=6)
    with pytest.raises(UnknownNameError, match="qpsolvers: solver 'qadprog': did you mean 'quadprog'"):
        create("qpsolvers:qadprog")
    absent = next(name for name, reason in reasons().items() if reason is not None)
    with pytest.raises(SolverError, match=rf"'qpsolvers:{absent}' cannot run: .*pip install qpsolvers.{absent}"):
        create(f"qpsolvers:{absent}")


@every_library
def test_advice_is_the_default_and_can_be_left_out(library):
    plain = QPSolver(library, advised=False)
    assert plain.advice == (1.0, {})
    assert QPSolver(library).advice == ADVICE[library]
    given = dict.fromkeys(sorted(ALLOWED.get(f"qpsolvers:{library}", ()))[:1], 1)
    mixed = QPSolver(library, cost_scale=7.0, options=given)
    assert mixed.advice.cost_scale == 7.0
    assert mixed.advice.options == {**ADVICE[library].options, **given}


@every_library
def test_both_row_forms_and_scales_give_the_same_answer(library):
    qp = problem(1)
    exact = create("exact").start(qp).solve(qp).x
    for rows in (5, 6):
        for cost_scale in (1e3, 3e3):
            found = QPSolver(library, rows=rows, cost_scale=cost_scale).start(qp).solve(qp)
            assert found.status is Status.SOLVED
            np.testing.assert_allclose(found.x, exact, atol=1e-3)
            assert qp.residuals(found.x, found.y).natural < 1e-5


def test_options_reach_the_library():
    qp = problem(2)
    loose = QPSolver("osqp", options={"eps_abs": 1e-2, "eps_rel": 1e-2}).start(qp).solve(qp)
    tight = QPSolver("osqp").start(qp).solve(qp)
    assert qp.residuals(loose.x).primal > 1e-5 > qp.residuals(tight.x).primal
    short = QPSolver("osqp", options={"max_iter": 3}).start(qp).solve(qp)
    assert short.status is Status.MAX_ITER
    assert np.isnan(short.x).all()


@every_library
def test_unknown_options_are_refused(library):
    with pytest.raises(SolverError, match="option 'no_such_option' is not among those"):
        QPSolver(library, options={"no_such_option": 1})


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


def test_warm_hands_the_last_answer_over(monkeypatch):
    seen, solve = [], qpsolvers.solve_problem

    def spy(problem, library, start, **options):
        seen.append(start)
        return solve(problem, library, start, **options)

    monkeypatch.setattr(qpsolvers, "solve_problem", spy)
    qps = smooth_sequence(np.random.default_rng(6), 3)
    session = QPSolver("osqp", warm=True).start(qps[0])
    seen.clear()
    first = session.solve(qps[0])
    kept = first.x.copy()
    first.x[:] = 9.0
    session.solve(qps[1])
    assert seen[0] is None
    np.testing.assert_array_equal(seen[1], kept)
    seen.clear()
    cold = QPSolver("osqp").start(qps[0])
    for qp in qps:
        cold.solve(qp)
    assert all(x is None for x in seen)


@every_library
def test_no_warning_escapes(library):
    """qpsolvers warns of conversions and failures at every call; here the status says it."""
    good, bad = problem(7), infeasible_problem(np.random.default_rng(7))
    session = QPSolver(library, warm=True).start(good)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for qp in (good, good, bad):
            session.solve(qp)


def test_settings_are_frozen_and_travel():
    chosen = QPSolver("daqp", options={"eta_prox": 1e-12})
    with pytest.raises(TypeError):
        chosen.options["eta_prox"] = 1.0
    assert pickle.loads(pickle.dumps(chosen)) == chosen
    assert hash(chosen) == hash(pickle.loads(pickle.dumps(chosen)))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rows": 4}, "qpsolvers:daqp: rows = 4 is not one of 5, 6"),
        ({"cost_scale": 0.0}, "cost_scale = 0.0 is not a positive number"),
        ({"options": 3}, "options = 3 is not a table"),
        ({"advised": "no"}, "advised = 'no'"),
        ({"warm": None}, "warm = None"),
    ],
)
def test_bad_settings_are_named(values, message):
    with pytest.raises(SolverError, match=message):
        QPSolver("daqp", **values)
