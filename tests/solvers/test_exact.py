"""Answers of the solver `exact`, which is the reference for all other solvers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space
from scipy.optimize import linprog

from moc_opt import core
from moc_opt.errors import SolverError
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import Status
from moc_opt.solvers.exact import Exact
from tests.hard_problems import hard_problems, nearly_singular, remade, rounded
from tests.problems import changed, infeasible_problem, out_of_reach, random_problem, unit


def solve(qp):
    return Exact().start(qp).solve(qp)


def check(qp, primal=np.inf):
    solution = solve(qp)
    found = qp.residuals(solution.x, solution.y)
    assert solution.status is Status.SOLVED
    assert found.verified(), found
    assert found.primal < primal
    return solution


@settings(max_examples=60)
@given(seed=st.integers(0, 100_000), n=st.sampled_from([6, 7, 8, 9, 11]), structured=st.booleans(),
       regularization=st.sampled_from([0.0, 1e-8, 1e-6, 1e-5, 1e-3, 1.0]))  # fmt: skip
def test_answers_satisfy_the_kkt_conditions_for_any_number_of_joints(seed, n, structured, regularization):
    qp = random_problem(np.random.default_rng(seed), n, structured=structured, regularization=regularization)
    # The primal residual grows with the condition number of A.
    s = np.linalg.svd(qp.A, compute_uv=False)
    solution = check(qp, 1e-14 * s[0] / s[s > 1e-9 * s[0]][-1] * 10 + 1e-13)
    assert qp.residuals(solution.x, solution.y).natural < 1e-11


@pytest.mark.parametrize("decimals", [7, 8, 9, 10, 11, 12, 13, 14])
def test_answers_for_rounded_jacobians_agree_with_linprog(decimals):
    """Rounding makes the sixth row slightly independent of the other five. linprog gets only five rows."""
    rng, refused = np.random.default_rng(decimals), 0
    for k in range(16):
        qp = rounded(random_problem(rng, 6 + k % 4, structured=k % 8 < 4, regularization=0.0), decimals)
        if solve(qp).status is Status.NUMERICAL:
            refused += 1
            continue
        U, bounds = np.linalg.svd(qp.A)[0][:, :5], list(zip(qp.lower, qp.upper, strict=True))
        best = linprog(-qp.grad_mu, A_eq=U.T @ qp.A, b_eq=U.T @ qp.b, bounds=bounds)
        assert -qp.grad_mu @ check(qp).x == pytest.approx(best.fun, abs=2e-6)
    assert refused <= (2 if decimals == 7 else 0)


@pytest.mark.parametrize("regularization", [0.0, 1e-8, 1e-5, 1.0])
@pytest.mark.parametrize(("n", "seed"), [(7, 18), (8, 18), (9, 18), (10, 74), (11, 696), (12, 1075)])
def test_problem_with_a_feasible_corner_of_bounds_is_solved(n, seed, regularization):
    # Some of these problems have only one feasible point.
    rng = np.random.default_rng(seed)
    for i in range(16):
        qp = random_problem(rng, n, structured=bool(i % 2), regularization=regularization)
        corner = np.where(rng.random(n) < 0.5, qp.lower, qp.upper)
        check(changed(qp, v_tip=qp.J_tip @ corner, v_wrist=qp.J_wrist @ corner))


def wedge(rng, n, narrow, size=1.0, **settings):
    """Return a problem whose feasible set ends in a wedge with an angle of about ``narrow``."""
    Z = rng.normal(size=(n - 6, n))
    Z[:, 1] = 1.3 * Z[:, 0] + narrow * rng.normal(size=n - 6)
    Z[:, 3] = -0.8 * Z[:, 2] + narrow * rng.normal(size=n - 6)
    A = null_space(Z).T
    lower, upper = -size * rng.uniform(0.3, 3.0, n), size * rng.uniform(0.3, 3.0, n)
    x = 0.5 * (lower + upper) + 0.45 * (upper - lower) * rng.uniform(-1.0, 1.0, n)
    lower[0], upper[1] = x[0] - 0.3 * size * narrow, x[1] + 0.2 * size * narrow
    return NullSpaceQP(A[:3], A[3:], A[:3] @ x, A[3:] @ x, rng.normal(size=n), lower, upper, **settings)


@pytest.mark.parametrize(("n", "narrow"), [(8, 1e-4), (9, 1e-4), (10, 1e-4), (15, 1e-6)])
def test_answer_is_accurate_if_the_feasible_set_ends_in_a_wedge(n, narrow):
    rng = np.random.default_rng(n)
    for _ in range(25):
        qp = wedge(rng, n, narrow)
        if narrow > 1e-5 or solve(qp).status is Status.SOLVED:  # NUMERICAL is allowed, a wrong answer is not
            check(qp, primal=1e-17 / narrow)


def test_most_problems_with_a_thin_wedge_are_solved():
    rng, found = np.random.default_rng(0), []
    for k in range(1000):
        n, narrow, size = rng.choice([8, 8, 9, 12, 16]), 10.0 ** rng.uniform(-7.0, -2.0), 10.0 ** rng.uniform(-3.0, 3.0)
        found.append(solve(wedge(rng, n, narrow, size, regularization=[0.0, 1e-8, 1e-5, 1.0][k % 4])).status)
    assert found.count(Status.SOLVED) > 940
    assert Status.INFEASIBLE not in found


def test_bound_of_a_joint_that_hardly_moves_does_not_stop_the_self_motion():
    rng, ends = np.random.default_rng(3), np.ones(8)
    for regularization in (0.0, 1e-5, 1.0):
        for _ in range(20):
            Z = rng.normal(size=(2, 8))
            Z[:, 7] = 3e-11 * rng.choice([-1.0, 1.0], 2)
            A, x = null_space(Z).T, rng.uniform(-0.9, 0.9, 8)
            x[7] = rng.choice([-1.0, 1.0])
            qp = NullSpaceQP(A[:3], A[3:], A[:3] @ x, A[3:] @ x, rng.normal(size=8), -ends, ends)
            qp = changed(qp, regularization=regularization)
            far = changed(qp, lower=-ends - 9.0 * np.eye(8)[7], upper=ends + 9.0 * np.eye(8)[7])
            np.testing.assert_allclose(check(qp).x[:7], solve(far).x[:7], atol=1e-8)


@pytest.mark.parametrize(("decimals", "answered"), [(12, True), (8, True), (7, True), (4, False)])
def test_rounded_velocities_of_tip_and_wrist_are_accepted_within_the_tolerance(decimals, answered):
    for seed in range(20):
        qp = random_problem(np.random.default_rng(seed), 7)
        kept = changed(qp, v_tip=qp.v_tip.round(decimals), v_wrist=qp.v_wrist.round(decimals))
        gap = np.abs(kept.A @ np.linalg.lstsq(kept.A, kept.b, rcond=1e-9)[0] - kept.b).max()
        if answered:
            check(kept)
        elif gap > 1e-6:
            assert solve(kept).status is Status.INFEASIBLE


def test_violation_equal_to_the_tolerance_is_allowed():
    A, wide, tolerance = np.eye(6, 7), np.ones(7), 2.0**-20

    def status(A, b, upper, tolerance=1e-9):
        qp = NullSpaceQP(A[:3], A[3:], b[:3], b[3:], wide, -wide, upper, regularization=1e-5)
        return core.solve_exact(qp.row, tolerance)[0]

    b, upper = np.full(6, 0.25), np.where(np.arange(7) == 0, 0.25 - tolerance, wide)
    assert status(A, b, upper, tolerance) == core.OK
    assert status(A, b, upper, tolerance * (1.0 - 2.0**-30)) == core.INFEASIBLE
    A[5] = A[4]
    assert [status(A, gap * np.eye(6)[5], wide) for gap in (1e-6, 1.1e-6)] == [core.OK, core.INFEASIBLE]


def test_answers_do_not_depend_on_units():
    """Only the status may depend on the unit of length, since the tolerance is absolute."""
    rng = np.random.default_rng(0)
    plain = [random_problem(rng, 7 + k % 3, structured=False, regularization=1e-5 * (k % 2)) for k in range(120)]
    problems = [nearly_singular(qp, 10.0 ** -rng.uniform(2, 15)) for qp in plain[:60]]
    problems += [rounded(qp, int(rng.integers(3, 15))) for qp in plain[60:]] + hard_problems()
    problems += [wedge(rng, 8 + k % 9, 1e-5) for k in range(60)] + [infeasible_problem(rng) for _ in range(30)]
    same = []
    for qp in problems:
        status, x, y = core.solve_exact(qp.row, 1e-9)
        for f in (2.0**-20, 2.0**20):
            dear = core.solve_exact(changed(qp, c2=f * qp.c2, regularization=f * qp.regularization).row, 1e-9)
            assert dear[0] == status
            if status == core.OK:
                np.testing.assert_array_equal([*dear[1], *dear[2] / f], [*x, *y])
        for f in (2.0**-7, 2.0**7):
            far = core.solve_exact(remade(qp, f * qp.A, f * qp.b).row, 1e-9)
            same.append(far[0] == status)
            if far[0] == core.OK == status:
                np.testing.assert_array_equal([*far[1], *f * far[2]], [*x, *y])
    assert np.mean(same) > 0.97


def test_self_motion_that_does_not_lower_the_cost_is_zero():
    qp = random_problem(np.random.default_rng(14), regularization=0.0)
    assert solve(qp).x[6] == 0.0
    assert solve(changed(qp, c2=0.0, grad_mu=np.ones(7))).x[6] == 0.0
    for size in (1e-3, 1e3):  # a slope along the self-motion below 1e-9 max |grad_mu| is taken as zero
        grads = [size * (qp.grad_mu + share * np.eye(7)[6] * np.abs(qp.grad_mu[:6]).max()) for share in (5e-10, 2e-9)]
        assert [abs(solve(changed(qp, grad_mu=grad)).x[6]) > 0.1 for grad in grads] == [False, True]
    none = remade(changed(qp, regularization=1.0), np.zeros((6, 7)), np.zeros(6))
    np.testing.assert_allclose(check(none).x, np.clip(qp.c2 * qp.grad_mu, qp.lower, qp.upper), atol=1e-15)
    flat = changed(qp, grad_mu=np.zeros(7), lower=-9.0 * np.ones(7), upper=9.0 * np.ones(7))
    np.testing.assert_allclose(check(flat).x, np.linalg.lstsq(qp.A, qp.b, rcond=None)[0], atol=1e-10)


def test_batch_gives_the_answers_of_single_solves():
    rng = np.random.default_rng(16)
    problems = [(random_problem if i % 5 else infeasible_problem)(rng, structured=i % 4 < 2) for i in range(40)]
    rows = np.array([qp.row for qp in problems])
    X, Y, statuses = Exact().solve_batch(rows)
    for threads in (1, 3, 64):
        again = Exact().solve_batch(rows, threads)
        np.testing.assert_array_equal(again[0], X)
        assert again[2] == statuses
    for wrong, call in (
        ("threads = 0", lambda: Exact().solve_batch(rows, 0)),
        ("rows has shape", lambda: Exact().solve_batch(rows[:, 1:])),
        ("17 joints: `exact` takes at most 16", lambda: Exact().start(random_problem(rng, 17))),
    ):  # fmt: skip
        with pytest.raises(SolverError, match=wrong):
            call()
    for i, (qp, x, y, status) in enumerate(zip(problems, X, Y, statuses, strict=True)):
        one = solve(qp)
        assert status is one.status is (Status.SOLVED if i % 5 else Status.INFEASIBLE)
        assert np.isnan(x).all() == (i % 5 == 0)
        np.testing.assert_array_equal(x, one.x)
        np.testing.assert_array_equal(y, np.full(6, np.nan) if one.y is None else one.y)


@pytest.mark.parametrize("decimals", range(3, 16))
@pytest.mark.parametrize("singular", [False, True])
def test_no_answer_is_wrong_near_the_rank_tolerance(decimals, singular):
    rng = np.random.default_rng(decimals)
    for k in range(8):
        plain = random_problem(rng, 7 + k % 3, structured=False, regularization=0.0 if k % 2 else 1e-5)
        qp = nearly_singular(plain, 10.0**-decimals) if singular else rounded(plain, decimals)
        solution = solve(qp)
        assert solution.status is not Status.SOLVED or qp.residuals(solution.x, solution.y).verified()


@pytest.mark.parametrize("freedoms", [0, 1])
def test_violation_that_rounding_explains_is_accepted(freedoms):
    """x may exceed its bounds by 100 e. Here e = 4e-12 max(|A| |x|) / (smallest pivot) [rad/s] estimates rounding."""
    wide = np.full(7, 10.0)
    for smallest, beyond, status in (
        (1e-3, 2e-6, Status.SOLVED), (1e-3, 2e-5, Status.INFEASIBLE), (1.0, 1e-7, Status.INFEASIBLE)
    ):  # fmt: skip
        A = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, smallest, 0.0])[:6]
        A[0, 6] = freedoms
        b = A[:, 5] * (10.0 + beyond)
        qp = NullSpaceQP(A[:3], A[3:], b[:3], b[3:], np.ones(7), lower=-wide, upper=wide, regularization=1e-5)
        assert solve(qp).status is status


def test_answers_near_a_straight_elbow_are_feasible(robot):
    rng, one = np.random.default_rng(10248), np.ones(16)
    A = rng.integers(-1, 2, (6, int(rng.integers(9, 17)))).astype(float)
    A[:, 8:] = A[:, :8]  # first, an infeasible problem of random numbers, without an arm
    b = A @ (np.where(rng.random(16) < 0.5, -1.0, 1.0) + rng.normal(size=16) * 10 ** rng.uniform(-4, 1))
    assert solve(NullSpaceQP(A[:3], A[3:], b[:3], b[3:], rng.normal(size=16), -one, one)).status is not Status.SOLVED
    unverified = np.zeros(3)
    for k in range(600):  # by turns: elbow near 0, wrist at 1e-9 rad (slow self-motion), elbow at 1e-10 rad
        q, v = rng.uniform(robot.q_min, robot.q_max), robot.v_max
        q[3], q[5] = [(rng.uniform(-0.01, 0.01), q[5]), (q[3], 1e-9), (1e-10, q[5])][k % 3]
        s, x = robot.state(q), np.where(rng.random(7) < 0.5, rng.choice([-1.0, 1.0], 7) * v, rng.uniform(-v, v))
        qp = NullSpaceQP(s.J_tip, s.J_wrist, s.J_tip @ x, s.J_wrist @ x, s.grad_mu, -v, v)
        solution = solve(qp)
        if k % 3 == 2 and solution.status is Status.NUMERICAL:
            continue
        found = qp.residuals(solution.x, solution.y)
        assert solution.status is Status.SOLVED
        assert found.primal <= 1e-6
        unverified[k % 3] += not found.verified()
    assert (unverified <= [0, 0, 5]).all(), "at 1e-10 rad, rounding errors of b can make a problem infeasible"


@pytest.mark.parametrize(("moves", "stops"), [(1.6e-10, True), (1.2e-10, False)])
def test_solver_and_residuals_agree_on_slow_joints(moves, stops):
    """A joint at its bound stops the self-motion z only if its entry of z is above 1e-10 |z| = 1.38e-10."""
    z, x, wide = np.array([1.0, -0.5, 0.3, 0.2, -0.4, 0.6, moves]), np.zeros(7), np.ones(7)
    A, x[6] = null_space(z[None]).T, 1.0
    found = check(NullSpaceQP(A[:3], A[3:], A[:3] @ x, A[3:] @ x, z, -wide, wide, regularization=1e-5)).x
    assert found[0] == pytest.approx(0.0 if stops else 1.0, abs=1e-5)
    low, high = -wide, np.array(wide)  # now the slow joint is far from its bounds
    low[0], high[0] = 0.0, 1e-5
    short = NullSpaceQP(A[:3], A[3:], np.zeros(3), np.zeros(3), z, low, high, regularization=1e-5)
    assert [bool(short.residuals(end * z).verified()) for end in (0.0, 1e-5)] == [False, True]


def test_problem_with_a_feasible_corner_is_seldom_refused():
    """Where a column of A is as small as 1e-3, a rounding error of b is a thousand times as large in x."""
    rng, refused = np.random.default_rng(1), 0
    for _ in range(300):
        n, u = int(rng.integers(6, 10)), unit(rng)
        J_tip, J_wrist = rng.normal(size=(2, 3, n)) * 10.0 ** rng.uniform(-3.0, 3.0, n)
        J_wrist += np.outer(u, u @ (J_tip - J_wrist))
        lower, upper = -(10.0 ** rng.uniform(-2.0, 1.0, n)), 10.0 ** rng.uniform(-2.0, 1.0, n)
        x = np.where(rng.uniform(size=n) < 0.5, lower, upper)
        qp = NullSpaceQP(J_tip, J_wrist, J_tip @ x, J_wrist @ x, rng.normal(size=n), lower, upper)
        found = solve(qp)
        refused += found.status is not Status.SOLVED
        if found.status is Status.SOLVED:
            assert ((qp.lower <= found.x) & (found.x <= qp.upper)).all()
            assert np.abs(qp.A @ found.x - qp.b).max() <= 1e-6
        assert solve(out_of_reach(rng, qp)).status is not Status.SOLVED
    assert refused <= 2
