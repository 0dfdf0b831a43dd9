"""The OSQP adapter beyond the conformance suite: its settings, and what the library's own ones would do."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.errors import SolverError
from moc_opt.solvers import Status
from moc_opt.solvers.backends.osqp import OSQP
from tests.problems import random_problem, smooth_sequence


def solve(chosen, qp):
    return chosen.start(qp).solve(qp)


def test_both_row_forms_agree():
    rng = np.random.default_rng(0)
    for _ in range(10):
        qp = random_problem(rng)
        five, six = solve(OSQP(rows=5), qp), solve(OSQP(rows=6), qp)
        assert five.status is six.status is Status.SOLVED
        np.testing.assert_allclose(five.x, six.x, atol=1e-4)
        assert max(qp.residuals(s.x, s.y).natural for s in (five, six)) < 1e-6


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


def test_polishing_ends_at_rounding():
    qp = random_problem(np.random.default_rng(3))
    rough, fine = (qp.residuals(*solve(OSQP(eps=1e-5, polishing=p), qp)[:2]) for p in (False, True))
    assert fine.natural < 1e-12 < rough.natural


def test_a_warm_start_saves_iterations():
    qps = smooth_sequence(np.random.default_rng(4), 40)
    total = {}
    for warm in (True, False):
        session = OSQP(warm=warm, check_termination=1).start(qps[0])
        total[warm] = sum(session.solve(qp).iterations for qp in qps[1:])
    assert total[True] < 0.8 * total[False]


def test_cold_forgets_everything():
    qps = smooth_sequence(np.random.default_rng(5), 10)
    session = OSQP(warm=False).start(qps[0])
    for qp in qps:
        found = session.solve(qp)
    fresh = OSQP(warm=False).start(qps[-1]).solve(qps[-1])
    np.testing.assert_allclose(found.x, fresh.x, atol=1e-10)
    assert found.iterations == fresh.iterations


def test_another_shape_starts_another_workspace():
    rng = np.random.default_rng(6)
    session = OSQP().start(random_problem(rng))
    for n in (9, 6, 7):
        qp = random_problem(rng, n, structured=False)
        found = session.solve(qp)
        assert found.status is Status.SOLVED
        assert qp.residuals(found.x, found.y).verified()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rows": 7}, "osqp: rows = 7 is not one of 5, 6"),
        ({"eps_rel": -1.0}, "eps_rel = -1.0 is not a number of 0 or larger"),
        ({"max_iter": 1e4}, "max_iter = 10000.0 is not a whole number"),
        ({"check_termination": 0}, "check_termination = 0"),
        ({"polishing": 1}, "polishing = 1 is neither"),
        ({"rows": True}, "rows = True"),
    ],
)
def test_bad_settings_are_named(values, message):
    with pytest.raises(SolverError, match=message):
        OSQP(**values)
