"""The networks follow their equations and refuse unstable settings."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from moc_opt.errors import SolverError
from moc_opt.solvers import Status
from moc_opt.solvers.base import ObservingSession
from moc_opt.solvers.rnn import RNN, RNNPrinted, unstable
from tests.problems import changed, infeasible_problem, random_problem, smooth_sequence

SEEDS = st.integers(0, 100_000)


def right_hand_side(qp, x, l1, l2, k, scale=1.0):
    """Return eps times the time derivatives of x, l1 and l2 as in docs/method.md, term by term."""
    c0, c1, c2, rho = (scale * w for w in (qp.c0, qp.c1, qp.c2, qp.regularization))
    JT, JW = qp.J_tip, qp.J_wrist
    force = c0 * JT.T @ (JT @ x - qp.v_tip) + c1 * JW.T @ (JW @ x - qp.v_wrist) + rho * x - c2 * qp.grad_mu
    force += JT.T @ l1 + JW.T @ l2
    dx = -x + np.clip(x - k * force, qp.lower, qp.upper)
    return dx, k * (JT @ x - qp.v_tip), k * (JW @ x - qp.v_wrist)


@pytest.mark.parametrize("method", ["explicit", "semi-implicit"])
@pytest.mark.parametrize("h", [1.0, 0.7])
def test_steps_integrate_the_networks_equation(method, h):
    qp = random_problem(np.random.default_rng(0), c0=0.01, c1=0.02)
    chosen = RNN(steps=25, h=h, k=0.3, method=method)
    found = chosen.start(qp).solve(qp)
    x, l1, l2 = np.zeros(7), np.zeros(3), np.zeros(3)
    for _ in range(chosen.steps):
        dx, d1, d2 = right_hand_side(qp, x, l1, l2, chosen.k, chosen.scale)
        x = x + h * dx
        if method == "semi-implicit":
            _, d1, d2 = right_hand_side(qp, x, l1, l2, chosen.k, chosen.scale)
        l1, l2 = l1 + h * d1, l2 + h * d2
    assert found.iterations == chosen.steps
    assert found.status is Status.MAX_ITER
    np.testing.assert_allclose(found.x, x, atol=1e-13)
    np.testing.assert_allclose(found.y, np.concatenate([l1, l2]) / chosen.scale, atol=1e-13)


def spectral_radius(qp, c, h, k, implicit, h_x):
    """Return the spectral radius of the matrix of one step, without active bounds and without regularization."""
    A, hk, hk_x = qp.A, h * k, h_x * k
    m, n = A.shape
    onto_x = np.hstack([np.eye(n) - hk_x * c * A.T @ A, -hk_x * A.T])
    seen = onto_x if implicit else np.eye(n, n + m)
    step = np.vstack([onto_x, np.hstack([np.zeros((m, n)), np.eye(m)]) + hk * A @ seen])
    U, _, Vt = np.linalg.svd(A)
    basis = block_diag(Vt[:5].T, U[:, :5])  # components in the null spaces of A and A^T stay constant
    return np.abs(np.linalg.eigvals(basis.T @ step @ basis)).max()


@settings(max_examples=100)
@given(
    seed=SEEDS, c=st.floats(1e-3, 20.0), k=st.floats(1e-3, 10.0), h=st.floats(0.05, 1.0),
    implicit=st.booleans(), h_x=st.none() | st.floats(0.05, 1.0),
)
def test_settings_are_called_unstable_exactly_where_a_step_diverges(seed, c, k, h, implicit, h_x):
    qp = random_problem(np.random.default_rng(seed), c0=c, c1=c, regularization=0.0)
    radius = spectral_radius(qp, c, h, k, implicit, h if h_x is None else h_x)
    if abs(radius - 1.0) > 1e-9:  # nearer to 1, rounding decides
        assert (unstable(qp, h, k, 1.0, implicit, h_x) is None) == (radius < 1.0)


def test_error_for_unstable_settings_names_the_remedy():
    qp = random_problem(np.random.default_rng(1))
    for chosen in (RNN(scale=1.0), RNN(k=0.9, scale=89.0), RNNPrinted(h=0.11)):
        reason = chosen.supports(qp)
        assert "diverge" in reason
        assert "lower h or k" in reason
        with pytest.raises(SolverError, match=rf"{chosen.name}: h k = "):
            chosen.start(qp)
    assert RNN(scale=1.0, method="semi-implicit").supports(qp) is None
    assert "above 0" in RNN(method="semi-implicit").supports(random_problem(np.random.default_rng(1), c0=0.0))


@settings(max_examples=60)
@given(seed=SEEDS, steps=st.sampled_from([1, 10, 1000, 30_000]), infeasible=st.booleans())
def test_a_claimed_answer_is_verified_and_x_stays_in_the_box(seed, steps, infeasible):
    make = infeasible_problem if infeasible else random_problem
    qp = make(np.random.default_rng(seed))
    chosen = RNN(steps=steps, k=0.2)
    assume(chosen.supports(qp) is None)  # the network refuses very large arms, because its steps would diverge
    found = chosen.start(qp).solve(qp)
    assert np.all(found.x >= qp.lower - 1e-15)
    assert np.all(found.x <= qp.upper + 1e-15)
    if found.status is Status.SOLVED:
        assert not infeasible
        assert qp.residuals(found.x, found.y).verified()


def test_network_restarts_from_zero_after_overflow():
    good = random_problem(np.random.default_rng(5))
    huge = changed(good, J_tip=1e200 * good.J_tip, J_wrist=1e200 * good.J_wrist)
    session = RNN(k=0.2).start(good)
    assert session.solve(huge).status is Status.NUMERICAL
    fresh = RNN(k=0.2).start(good).solve(good)
    np.testing.assert_array_equal(session.solve(good).x, fresh.x)


def test_rnn_printed_applies_equation_2_to_measured_velocity():
    """Equation (2) of Su et al. 2019: from the measured v, x = P(v - k dL/dx). P clips to the bounds."""
    qps = smooth_sequence(np.random.default_rng(6), 40, regularization=0.0)
    chosen = RNNPrinted()
    assert chosen.h == 0.002  # dt/eps for eps = 1 s at 500 Hz
    assert (chosen.k, qps[0].c0, qps[0].c1, qps[0].c2) == (0.1, 0.01, 0.01, 0.001)
    session = chosen.start(qps[0])
    rng = np.random.default_rng(7)
    x, l1, l2 = np.zeros(7), np.zeros(3), np.zeros(3)
    for tick, qp in enumerate(qps):
        if tick % 3:  # otherwise the network continues from its previous x
            x = rng.uniform(-1.0, 1.0, 7)
            session.observe(x)
        dx, d1, d2 = right_hand_side(qp, x, l1, l2, 0.1)
        x, l1, l2 = x + dx, l1 + chosen.h * d1, l2 + chosen.h * d2
        found = session.solve(qp)
        np.testing.assert_allclose(found.x, x, atol=1e-14)
        np.testing.assert_allclose(found.y, np.concatenate([l1, l2]), atol=1e-14)
        assert found.status is Status.MAX_ITER
    assert not isinstance(RNN().start(qps[0]), ObservingSession)


def test_only_a_converged_network_reports_solved():
    qp = random_problem(np.random.default_rng(3), regularization=0.01)
    many, few = (RNN(steps=steps).start(qp).solve(qp) for steps in (100_000, 10))
    assert (many.status, few.status, few.iterations) == (Status.SOLVED, Status.MAX_ITER, 10)
    assert many.iterations < 20_000
    assert qp.residuals(many.x, many.y).natural < 1e-8
