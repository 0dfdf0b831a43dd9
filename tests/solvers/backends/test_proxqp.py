"""The ProxQP adapter beyond the conformance suite: feasible, infeasible and stale starts told apart."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.errors import SolverError
from moc_opt.solvers import Status
from moc_opt.solvers.backends.proxqp import ProxQP
from tests.problems import infeasible_problem, random_problem, smooth_sequence

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


def test_a_second_attempt_starts_from_fresh_data():
    """At larger costs the warm attempt at an infeasible problem often fails; the cold one must not."""
    qps = alternating()
    session = ProxQP(cost_scale=1e3, eps_primal_inf=1e-8).start(qps[0])
    said = [session.solve(qp).status for qp in qps][1::2]
    assert said.count(Status.INFEASIBLE) >= 0.98 * len(said)


def test_the_library_as_it_comes_calls_feasible_problems_infeasible():
    """Why eps_primal_inf and cost_scale are what they are."""
    plain = ProxQP(eps=1e-5, eps_primal_inf=1e-4, cost_scale=1.0)
    rng = np.random.default_rng(1)
    said = []
    for _ in range(40):
        qp = random_problem(rng, regularization=0.0)
        said.append(plain.start(qp).solve(qp).status)
    assert said.count(Status.INFEASIBLE) > 10


def test_both_forms_of_the_box_agree():
    rng = np.random.default_rng(3)
    for _ in range(10):
        qp = random_problem(rng)
        one, two = (ProxQP(box=box).start(qp).solve(qp) for box in ("bounds", "rows"))
        np.testing.assert_allclose(one.x, two.x, atol=1e-6)


def test_max_iter_is_said():
    qp = random_problem(np.random.default_rng(4))
    found = ProxQP(max_iter=1, max_iter_in=1, eps=1e-12).start(qp).solve(qp)
    assert found.status is Status.MAX_ITER
    assert np.isfinite(found.x).all()


def test_a_warm_start_is_used_and_can_be_refused():
    qps = smooth_sequence(np.random.default_rng(5), 30)
    answers = {}
    for warm in (True, False):
        session = ProxQP(warm=warm).start(qps[0])
        answers[warm] = [session.solve(qp).x for qp in qps]
    assert any(not np.array_equal(a, b) for a, b in zip(answers[True], answers[False], strict=True))
    np.testing.assert_allclose(answers[True], answers[False], atol=1e-6)


def test_another_shape_starts_another_workspace():
    rng = np.random.default_rng(6)
    session = ProxQP().start(random_problem(rng))
    for n in (9, 6, 7):
        qp = random_problem(rng, n, structured=False)
        found = session.solve(qp)
        assert found.status is Status.SOLVED
        assert qp.residuals(found.x, found.y).verified()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rows": "5"}, "proxqp: rows = '5' is not one of 5, 6"),
        ({"box": "none"}, "box = 'none' is not one of 'bounds', 'rows'"),
        ({"eps_primal_inf": 0}, "eps_primal_inf = 0 is not a positive number"),
        ({"max_iter_in": -3}, "max_iter_in = -3 is not a whole number"),
    ],
)
def test_bad_settings_are_named(values, message):
    with pytest.raises(SolverError, match=message):
        ProxQP(**values)
