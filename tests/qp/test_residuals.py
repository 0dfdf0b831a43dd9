"""The residuals of an answer."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp

from moc_opt.qp import residuals as optimality
from moc_opt.qp.problem import NullSpaceQP, compute_residuals
from moc_opt.qp.residuals import Residuals
from moc_opt.solvers.exact import Exact
from tests.problems import changed, random_problem
from tests.wrong_answers import candidates, cost, kernel, wrong_corners

CASES = [(7, True), (7, False), (8, False)]


def optimum(qp):
    solution = Exact().start(qp).solve(qp)
    return solution.x, solution.y


@pytest.mark.parametrize("regularization", [0.0, 1e-5])
@pytest.mark.parametrize(("n", "structured"), [*CASES, (12, False)])
def test_optimum_is_verified_and_its_neighbours_are_not(n, structured, regularization):
    rng = np.random.default_rng(5)
    for _ in range(8):
        qp = random_problem(rng, n, structured=structured, regularization=regularization)
        x, y = optimum(qp)
        found = qp.residuals(x, y)
        assert found.verified()
        assert max(found.primal, found.natural, found.natural_best) < 1e-12
        assert max(found.relative, found.loss) < 1e-9
        with_bad_duals = qp.residuals(x, y + 1.0)
        assert with_bad_duals.natural > 1e-3
        assert with_bad_duals.natural_best == found.natural_best
        assert with_bad_duals.verified()
        broken = x + 1e-3 * rng.choice([-1.0, 1.0], size=n)
        assert not qp.residuals(broken, y).verified()
        if n == 12:  # too many joints to search for the best duals: natural_best uses the optimum's duals
            wrong = optimum(changed(qp, grad_mu=-qp.grad_mu))[0]
            assert qp.residuals(wrong).natural_best == pytest.approx(qp.residuals(wrong, y).natural, rel=1e-6)


@pytest.mark.parametrize(("n", "structured"), CASES)
def test_natural_best_is_the_minimum_of_natural_over_all_duals(n, structured):
    """Bisection finds the minimum. A linear program decides whether some duals y give a residual of t or less."""
    rng = np.random.default_rng(7)

    def reachable(qp, x, t):
        low, high = np.where(qp.upper - x <= t, -np.inf, -t), np.where(x - qp.lower <= t, np.inf, t)
        scale, slope = 1e4, qp.P @ x + qp.p  # scale keeps numbers above milp's tolerance
        rows = LinearConstraint(qp.A.T, scale * (low - slope), scale * (high - slope))
        return milp(np.zeros(6), constraints=rows, bounds=Bounds()).status == 0

    for _ in range(3):
        qp = random_problem(rng, n, structured=structured)
        x = np.clip(optimum(qp)[0] + rng.normal(scale=1e-5, size=n), qp.lower, qp.upper)
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if reachable(qp, x, middle) else (middle, high)
        assert qp.residuals(x).natural_best == pytest.approx(high, rel=2e-3, abs=2e-9)


def ends_of_the_swivel(qp):
    """Return the optimum and the feasible point with the largest cost, for a problem with one self-motion."""
    x, _ = optimum(qp)
    moving = np.abs(qp.A).max(0) > 1e-12
    z = np.zeros(qp.n)
    z[moving] = np.linalg.svd(qp.A[:, moving])[2][-1]
    used = np.abs(z) > 1e-9
    steps = np.stack([(qp.lower - x)[used] / z[used], (qp.upper - x)[used] / z[used]])
    ends = x + np.outer([steps.min(0).max(), steps.max(0).min()], z)
    return x, ends[np.argmax(cost(qp, ends))]


@pytest.mark.parametrize("regularization", [0.0, 1e-5, 1e-3])
def test_loss_is_cost_above_optimum_divided_by_cost_range(regularization):
    rng = np.random.default_rng(8)
    for _ in range(5):
        qp = random_problem(rng, regularization=regularization)
        x, worst = ends_of_the_swivel(qp)
        assert qp.residuals(x).loss == pytest.approx(0.0, abs=1e-9)
        assert qp.residuals(worst).loss == pytest.approx(1.0, abs=1e-9)
        for share in (0.03, 0.25, 0.9):
            between = x + share * (worst - x)
            expected = (cost(qp, between) - cost(qp, x)) / (cost(qp, worst) - cost(qp, x))
            found = qp.residuals(between)
            assert found.loss == pytest.approx(expected, abs=1e-9)
            assert found.distance == pytest.approx(share * np.abs(worst - x).max(), rel=1e-6)
        assert qp.residuals(worst + 0.1 * (worst - x)).loss == 1.0
        assert 0.0 <= qp.residuals(x - 0.1 * (worst - x)).loss <= 1.0


@pytest.mark.parametrize("regularization", [0.0, 0.3])
@pytest.mark.parametrize("tilt", [1.0, 1e-3])
@pytest.mark.parametrize("size", [1.0, 3e-4])
@pytest.mark.parametrize("n", [7, 8, 9])
def test_no_wrong_corner_is_verified(n, size, tilt, regularization):
    wrong = wrong_corners(n, n, 4, tilt=tilt, size=size, regularization=regularization)
    assert len(wrong) > 10
    found = compute_residuals(np.array([w.qp.row for w in wrong]), np.array([w.x for w in wrong]))
    assert found.primal.max() < 1e-12
    assert not found.verified().any()
    np.testing.assert_allclose(found.loss, [w.share for w in wrong], atol=1e-6)
    assert found.distance.min() > 1e-6
    assert found.relative.max() > 1e-2 * size


@pytest.mark.parametrize(("gates", "verified"), [
    ({}, True), ({"primal": 2e-6}, False), ({"relative": 2e-3}, False), ({"loss": 2e-2}, False),
    ({"relative": 1.0, "loss": 1.0, "distance": 1e-6}, True),
    ({"relative": 1.0, "loss": 1.0, "distance": 1.1e-6}, False), ({"primal": 2e-6, "distance": 0.0}, False),
])  # fmt: skip
def test_verified_compares_each_residual_with_its_threshold(gates, verified):
    at_the_limit = {
        "primal": 1e-6, "natural": 9.0, "natural_best": 9.0, "relative": 1e-3, "loss": 1e-2, "distance": 1.0,
    }  # fmt: skip
    figures = {key: np.array(value) for key, value in {**at_the_limit, **gates}.items()}
    assert Residuals(**figures).verified() == verified
    batch = Residuals(**{key: np.array([value, np.inf]) for key, value in figures.items()})
    assert batch.verified().tolist() == [verified, False]
    for key in ("primal", "relative", "loss"):
        assert not Residuals(**at_the_limit).verified(**{key: 0.9 * at_the_limit[key]})


def sliver(width, regularization=0.0):
    """Return (problem, optimum x, z). The feasible segment along z is `width` [rad/s] long."""
    qp = random_problem(np.random.default_rng(21), regularization=regularization)
    x, worst = ends_of_the_swivel(qp)
    z = (x - worst) / np.abs(x - worst).max()
    j = int(np.argmax(np.abs(z)))
    middle = 0.5 * (x + worst)
    lower, upper = np.array(qp.lower), np.array(qp.upper)
    lower[j], upper[j] = middle[j], middle[j] + width
    thin = changed(qp, lower=lower, upper=upper)
    return thin, optimum(thin)[0], z


@pytest.mark.parametrize("regularization", [0.0, 1e-5])
def test_answer_within_primal_tolerance_of_optimum_is_verified(regularization):
    qp, x, z = sliver(1e-5, regularization)
    for off, right in ((0.0, True), (9e-7, True), (1.5e-6, False), (1e-5, False)):
        found = qp.residuals(x - off * z)
        assert found.distance == pytest.approx(off, abs=1e-9)
        assert found.loss == pytest.approx(off / 1e-5, abs=1e-3)
        assert found.verified() == right
    for width, loss in ((5e-10, 0.0), (5e-9, 1.0)):  # a segment below 1e-9 rad/s is taken as a point: loss 0
        qp, x, z = sliver(width, regularization)
        assert qp.residuals(x - width * z).loss == pytest.approx(loss, abs=1e-4)


@pytest.mark.parametrize("regularization", [0.0, 1e-5])
@pytest.mark.parametrize("pull", [-2.0, 0.0, 3.0])
def test_idle_joint_is_compared_with_the_best_point_of_its_interval(pull, regularization):
    """The idle joint is the last one, which moves neither tip nor wrist."""
    qp = random_problem(np.random.default_rng(14), regularization=regularization)
    grad_mu = np.array(qp.grad_mu)
    grad_mu[6] = pull
    qp = changed(qp, grad_mu=grad_mu)
    x, worst = ends_of_the_swivel(qp)
    free = np.linspace(qp.lower[6], qp.upper[6], 2001)
    costs = 0.5 * regularization * free**2 - qp.c2 * pull * free
    for k in (0, 700, 2000):
        here = np.array(x)
        here[6] = free[k]
        found = qp.residuals(here)
        spread = np.ptp(costs)
        expected = (costs[k] - costs.min()) / spread if spread > 0.0 else 0.0
        assert found.loss == pytest.approx(expected, abs=2e-3)
        best = x[6] if spread > 0.0 else here[6]
        assert found.distance == pytest.approx(abs(here[6] - best), abs=1e-9)
        slope = regularization * here[6] - qp.c2 * pull
        size = max(qp.c2 * abs(pull), regularization) or 1.0
        for figure, s in ((found.natural_best, slope), (found.relative, slope / size)):
            assert figure == pytest.approx(abs(here[6] - np.clip(here[6] - s, qp.lower[6], qp.upper[6])), abs=1e-12)
    there = np.array(worst)
    there[6] = x[6]
    assert qp.residuals(there).loss == pytest.approx(1.0, abs=1e-9)


def test_loss_is_the_largest_loss_of_all_idle_joints():
    J, ones = np.diag([1.0, 0.0, 0.0]), np.ones(3)
    qp = NullSpaceQP(J, J, np.zeros(3), np.zeros(3), [0.0, 2.0, -1.0], -ones, ones)
    assert qp.residuals([0.0, 1.0, -1.0]).verified()
    for wrong in ([0.0, -1.0, -1.0], [0.0, 1.0, 1.0]):
        found = qp.residuals(wrong)
        assert (found.loss, found.distance) == pytest.approx((1.0, 2.0))


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("n", [7, 8])
def test_if_the_cost_is_constant_every_feasible_answer_is_verified(n, unit):
    qp = random_problem(np.random.default_rng(30), n, structured=False, regularization=0.0)
    Z = kernel(qp)
    x = optimum(qp)[0]
    across = unit * (qp.grad_mu - Z @ (Z.T @ qp.grad_mu))
    size = np.abs(across).max() / np.abs(Z[:, 0]).max()
    for share, flat in ((1e-10, True), (1e-8, False)):
        problem = changed(qp, grad_mu=across + share * size * Z[:, 0])
        best = optimum(problem)[0]
        wrong = max(candidates(problem, Z, x, damped=False), key=lambda c: float(cost(problem, c)))
        found = problem.residuals(wrong)
        assert (found.loss, found.relative, found.distance) == (0.0, 0.0, pytest.approx(0.0, abs=1e-12)) or not flat
        assert found.verified() == flat
        assert problem.residuals(best).verified()


def test_relative_residual_is_the_residual_of_the_scaled_cost():
    """The cost is divided by the larger of c2 |Z Z^T grad_mu|_inf and the regularization. Z Z^T grad_mu is small."""
    rooms = []
    for w in wrong_corners(5, 6, 8, tilt=1e-3):
        z = kernel(w.qp)[:, 0]
        for regularization in (0.0, 1.0):
            slope = z @ (regularization * w.x - w.qp.c2 * w.qp.grad_mu)
            scale = max(w.qp.c2 * abs(z @ w.qp.grad_mu) * np.abs(z).max(), regularization)
            room = np.where(z * slope > 0.0, w.x - w.qp.lower, w.qp.upper - w.x)[np.abs(z) > 1e-9].min()
            rooms.append(max(room, 0.0) > abs(slope) / scale / np.abs(z).sum())
            expected = min(abs(slope) / scale / np.abs(z).sum(), max(room, 0.0))
            found = changed(w.qp, regularization=regularization).residuals(w.x)
            assert found.relative == pytest.approx(expected, rel=1e-6, abs=1e-12)
    assert any(rooms)


@pytest.mark.parametrize("unit", [1.0, 1e-8])
def test_without_null_space_an_answer_that_meets_the_references_is_verified(unit):
    rng = np.random.default_rng(4)
    J, x = unit * rng.normal(size=(6, 6)), rng.uniform(-0.5, 0.5, 6)
    b = J @ x
    qp = NullSpaceQP(J[:3], J[3:], b[:3], b[3:], np.ones(6), -np.ones(6), np.ones(6))
    found = qp.residuals(x)
    assert found.verified()
    assert (found.relative, found.loss, found.natural_best) == (0.0, 0.0, 0.0)
    off = 1e-3 * rng.normal(size=6)
    assert qp.residuals(x + off).distance == pytest.approx(np.abs(off).max(), rel=1e-9)


def one_freedom(z, lower, upper):
    """Return a problem of six joints that can move only along z. The gradient of mu is z as well."""
    A = np.vstack([np.linalg.svd(z[None])[2][1:], np.zeros(6)])
    return NullSpaceQP(A[:3], A[3:], np.zeros(3), np.zeros(3), z, lower, upper, regularization=0.0)


@pytest.mark.parametrize(("width", "loss"), [(3e-8, 0.0), (3e-7, 1.0)])
@pytest.mark.parametrize("slow", [0, 5])
def test_interval_shorter_than_rounding_counts_as_a_point(slow, width, loss):
    """An error in the slow joint's bound changes the interval along z by 1 / abs(z_j) = 1e7 times the error."""
    z = np.full(6, np.sqrt(0.2))
    z[slow] = 1e-7
    lower, upper = np.full(6, -1.0), np.full(6, 1.0)
    lower[slow], upper[3] = 0.0, width * z[3]
    assert one_freedom(z, lower, upper).residuals(np.zeros(6)).loss == pytest.approx(loss, abs=1e-6)


def test_distance_is_measured_to_the_middle_of_contradicting_bounds():
    z = np.array([0.5, 0.5, 0.5, 0.3, 0.3, np.sqrt(0.07)])
    lower, upper = np.full(6, -1.0), np.full(6, 1.0)
    lower[0], upper[1] = 8e-7 * z[0], 4e-7 * z[1]
    assert one_freedom(z, lower, upper).residuals(np.zeros(6)).distance == pytest.approx(6e-7 * 0.5, rel=1e-6)


def test_products_that_cancel_are_accurate():
    rng = np.random.default_rng(3)
    A, x = rng.normal(size=(2, 6, 9)), rng.normal(size=(2, 9, 4))
    A[:, :, 8] = -(A[:, :, :8] @ x[:, :8])[:, :, 0]
    x[:, 8] = 1.0  # the product's first column is only rounding
    exact = np.vectorize(Fraction, otypes=[object])
    expected = np.array([exact(a) @ exact(b) for a, b in zip(A, x, strict=True)], dtype=float)
    np.testing.assert_allclose(optimality._product(A, x), expected, rtol=1e-15, atol=1e-30)


def test_mixed_batch_gives_the_residuals_of_single_problems():
    rng = np.random.default_rng(40)
    problems = [random_problem(rng, 7, structured=k % 2 == 0, regularization=1e-5 * (k % 3)) for k in range(9)]
    J = rng.normal(size=(6, 7))
    problems.append(NullSpaceQP(J[:3], J[3:], np.zeros(3), np.zeros(3), np.ones(7), -np.ones(7), np.ones(7)))
    X = np.array([np.clip(optimum(qp)[0] + 0.1 * (k % 2), qp.lower, qp.upper) for k, qp in enumerate(problems)])
    rows, Y = np.array([qp.row for qp in problems]).reshape(2, 5, -1), rng.normal(size=(10, 6))
    for y in (None, Y):
        together = compute_residuals(rows, X.reshape(2, 5, 7), None if y is None else y.reshape(2, 5, 6))
        for k, qp in enumerate(problems):
            alone = qp.residuals(X[k], None if y is None else y[k])
            np.testing.assert_allclose([f.ravel()[k] for f in together], alone, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("regularization", [0.0, 0.2])
def test_natural_and_primal_equal_their_definitions(regularization):
    rng = np.random.default_rng(50)
    for n in (7, 8):
        qp = random_problem(rng, n, structured=False)
        qp = changed(qp, c0=0.3, c1=2.5, c2=0.7, regularization=regularization)
        for _ in range(10):
            x, y = rng.uniform(1.3 * qp.lower, 1.3 * qp.upper), rng.normal(size=6)
            slope = qp.P @ x + qp.p + qp.A.T @ y
            found = qp.residuals(x, y)
            expected = np.abs(x - np.clip(x - slope, qp.lower, qp.upper)).max()
            assert found.natural == pytest.approx(expected, rel=1e-9)
            beyond = np.maximum(qp.lower - x, x - qp.upper).max()
            assert found.primal == pytest.approx(max(np.abs(qp.A @ x - qp.b).max(), beyond), rel=1e-12)
            bad = np.array(y)
            bad[3] = np.nan
            for none in (None, bad):  # without finite duals, the best duals are used
                without = qp.residuals(x, none)
                assert without.natural == without.natural_best == found.natural_best


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_set_of_idle_joints_does_not_depend_on_the_length_unit(scale):
    """A joint is idle if its column's length is below about 1e-12 |A|, whatever the scale of A."""
    rng = np.random.default_rng(51)
    A = rng.normal(size=(6, 8))
    A /= np.linalg.norm(A)
    for column, idle in ((1e-13, True), (1e-11, False)):
        A[:, 4] *= column / np.linalg.norm(A[:, 4])
        [(rows, moves)] = optimality._idle_patterns(scale * A[None])
        assert (rows.tolist(), moves.tolist()) == ([0], [j != 4 or not idle for j in range(8)])


@pytest.mark.parametrize("regularization", [0.0, 1e-5])
@pytest.mark.parametrize("n", [7, 8])
def test_distance_is_measured_to_the_only_feasible_point(n, regularization):
    """The bounds allow one point only. If it violates A x = b, the loss is 1 and the distance is infinite."""
    qp = random_problem(np.random.default_rng(17), n, structured=False, regularization=regularization)
    x, z = optimum(qp)[0], kernel(qp)[:, 0]
    lower, upper = np.array(x), np.array(x)
    j = int(np.argmax(np.abs(z)))
    lower[j] = upper[j] = x[j] + 1e-8
    shut = changed(qp, lower=lower, upper=upper)
    lower[j] = upper[j] = x[j] + 1e-3
    empty = changed(qp, lower=lower, upper=upper).residuals(x)
    assert (empty.loss, empty.distance) == (1.0, np.inf)
    assert shut.residuals(x).verified()
    for step in (0.1, -0.3):
        found = shut.residuals(x + step * z)
        assert found.distance == pytest.approx(abs(step) * np.abs(z).max(), abs=3e-6)
        assert found.loss == 0.0
        assert not found.verified()


@pytest.mark.parametrize("n", [7, 8])
def test_rest_is_not_optimal_if_bounds_exclude_it(n):
    """With grad_mu = 0, the cost is smallest at rest, but one lower bound is 0.1."""
    qp = random_problem(np.random.default_rng(60), n, structured=False, regularization=1.0)
    z = kernel(qp)[:, 0]
    j = int(np.argmax(np.abs(z)))
    lower = -np.ones(n)
    lower[j] = 0.1
    still = changed(qp, v_tip=np.zeros(3), v_wrist=np.zeros(3), grad_mu=np.zeros(n), lower=lower, upper=np.ones(n))
    found = still.residuals(np.zeros(n))
    assert found.distance >= 0.1 - 1e-9
    assert found.primal == pytest.approx(0.1)
    assert still.residuals(optimum(still)[0]).verified()


def test_nan_answer_has_the_worst_residuals_and_c2_does_not_change_the_relative_residual():
    qp = random_problem(np.random.default_rng(10), regularization=0.0)
    found = qp.residuals(np.full(7, np.nan))
    assert (found.primal, found.loss, found.verified()) == (np.inf, 1.0, False)
    middle = optimum(changed(qp, regularization=1.0))[0]
    big, small = (changed(qp, c2=c).residuals(middle).relative for c in (1.0, 1e-6))
    assert big == pytest.approx(small, rel=1e-9)


def test_rank_in_a_batch_does_not_depend_on_other_problems():
    s = np.array([[1.0, 1.0, 1.0, 1.0, 1.0, last] for last in (1.0, 1e-6, 1e-8, 0.0)])
    s = np.vstack([s, [1.0, 1.0, 1.0, 1.0, 1e-8, 1e-9], [1.0, 1.0, 1.0, 1.0, 1e-14, 1e-14]])
    expected = [6, 6, 5, 5, 5, 4]
    assert [int(optimality.ranks(one)) for one in s] == expected
    assert optimality.ranks(s.reshape(2, 3, 6)).ravel().tolist() == expected
