"""The adapters of solver libraries."""

from types import SimpleNamespace

import numpy as np
import pytest
import qpsolvers
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import MocOptError
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import Status, create
from moc_opt.solvers.library import LibrarySession
from moc_opt.solvers.nlp import SQP, Ipopt
from moc_opt.solvers.osqp import OSQP
from moc_opt.solvers.proxqp import ProxQP
from moc_opt.solvers.qpsolvers import ADVICE, QPSolver
from tests.problems import infeasible_problem, random_arm, random_problem

HERE = sorted(qpsolvers.available_solvers)


def solve(chosen, qp):
    return chosen.start(qp).solve(qp)


def problem(seed=0, **options):
    return random_problem(np.random.default_rng(seed), **options)


def problems(seed, count, **options):
    rng = np.random.default_rng(seed)
    return [random_problem(rng, **options) for _ in range(count)]


def test_problem_with_nan_is_not_passed_to_a_library():
    damaged = NullSpaceQP.from_row(np.full(87, np.nan))
    with pytest.raises(ValueError, match="not finite"):
        OSQP().start(problem()).solve(damaged)
    for name in HERE:
        assert QPSolver(name).start(problem()).solve(damaged).status in (Status.NUMERICAL, Status.UNSUPPORTED)


@pytest.mark.parametrize(("one", "other", "within"), [
    (OSQP(rows=5), OSQP(rows=6), 1e-4), (ProxQP(rows=5), ProxQP(rows=6), 1e-6),
    *((QPSolver(name, rows=5), QPSolver(name, rows=6, cost_scale=3e3), 2e-3) for name in HERE),
], ids=repr)  # fmt: skip
def test_five_and_six_constraint_rows_give_the_same_answer(one, other, within):
    for qp in problems(0, 5):
        a, b = solve(one, qp), solve(other, qp)
        assert a.status is b.status is Status.SOLVED
        np.testing.assert_allclose(a.x, b.x, atol=within)
        assert max(qp.residuals(s.x, s.y).natural for s in (a, b)) < 1e-5


class Buffers(LibrarySession):
    """A session whose arrays are stacked, padded and transposed, as some libraries need them."""

    def _allocate(self, m, n):
        sides = self.sides = np.full((2, m + n + 1), np.nan)
        self.columns = np.full((n, m + 2), np.nan)
        self.arrays = {
            "P": np.full((n, n), np.nan).T, "packed": np.full(n * (n + 1) // 2, np.nan), "p": np.full(n, np.nan),
            "A": self.columns[:, :m].T, "low": sides[0, :m], "high": sides[1, :m], "lower": sides[0, m : m + n],
            "upper": sides[1, m : m + n],
        }  # fmt: skip
        return {**self.arrays, "signs": self._settings.signs}

    def _run(self):
        return Status.SOLVED, 0, np.zeros(self._n), np.arange(1.0, self._m + 1.0)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000), n=st.sampled_from([6, 7, 9]), rows=st.sampled_from([5, 6]),
    tool=st.sampled_from(["apart", "any", 0, 1, 2]), scale=st.sampled_from([1.0, 1e3]),
    signs=st.tuples(*[st.sampled_from([1.0, -1.0, 0.5])] * 3),
)  # fmt: skip
def test_each_part_of_the_problem_is_written_to_its_array_with_its_scale_and_sign(seed, n, rows, tool, scale, signs):
    J, ones = np.random.default_rng(seed).normal(size=(2, 3, n)), np.ones(n)
    if isinstance(tool, int):  # a rigid tool along an axis
        J[1, tool] = J[0, tool]
    qp = problem(seed, n=n) if tool == "any" else NullSpaceQP(*J, *(J @ ones), ones, -ones, ones)
    m = 6 if tool == "apart" else rows  # without a rigid tool all six rows stay
    session = Buffers(SimpleNamespace(rows=rows, cost_scale=scale, signs=signs, needs=""), problem(1, n=6))
    found, arrays = session.solve(qp), session.arrays
    A, b = (qp.reduced().A, qp.reduced().b) if m == 5 else (qp.A, qp.b)
    for name, expected in {
        "P": scale * qp.P, "p": signs[0] * scale * qp.p, "A": A, "low": b, "high": b, "lower": signs[1] * qp.lower,
        "upper": signs[2] * qp.upper,
    }.items():  # fmt: skip
        np.testing.assert_allclose(arrays[name], expected, rtol=1e-12, atol=1e-13 * scale)
    np.testing.assert_array_equal(arrays["packed"], [arrays["P"][i, j] for j in range(n) for i in range(j + 1)])
    assert np.isnan(session.sides[:, -1]).all()
    assert np.isnan(session.columns[:, m:]).all()
    y, five = np.arange(1.0, m + 1.0), qp.assembled(rows)
    np.testing.assert_allclose(found.y, y @ five.lift / scale, atol=1e-14)
    np.testing.assert_allclose(qp.A.T @ found.y, five.A.T @ y / scale, atol=1e-12)


@pytest.mark.parametrize("regularization", [1e-5, 0.0])
@pytest.mark.parametrize("rows", [5, 6])
def test_warm_session_survives_infeasible_problems(rows, regularization):
    rng, session = np.random.default_rng(1), ProxQP(rows=rows).start(problem())
    for k in range(80):
        qp = (infeasible_problem if k % 2 else random_problem)(rng, regularization=regularization)
        answer = session.solve(qp)
        assert answer.status is (Status.INFEASIBLE if k % 2 else Status.SOLVED)
        assert np.isnan(answer.x).all() if k % 2 else qp.residuals(*answer[:2]).verified(1e-7, 1e-4, 1e-4)


def test_options_reach_the_library():
    qp = problem(2)
    loose = solve(QPSolver("osqp", options={"eps_abs": 1e-2, "eps_rel": 1e-2}), qp)
    assert qp.residuals(loose.x).primal > 1e-5 > qp.residuals(solve(QPSolver("osqp"), qp).x).primal
    short = solve(QPSolver("osqp", options={"max_iter": 3}), qp)
    assert short.status is Status.MAX_ITER
    assert np.isnan(short.x).all()
    with pytest.raises(MocOptError, match="'no_such'"):
        QPSolver("daqp", options={"no_such": 1})


def test_expired_time_limit_gives_the_status_time_limit():
    """Without the limit, HiGHS does not terminate here."""
    assert solve(QPSolver("highs", advised=False, options={"time_limit": 0.02}), problem(3)).status is Status.TIME_LIMIT
    assert "time_limit" in ADVICE["highs"].options


@pytest.mark.parametrize("kind", [SQP, Ipopt])
def test_nonlinear_step_moves_tip_and_wrist_exactly(kind):
    """In a period T, the tip moves by v_tip T. The same holds for the wrist's motion across the shaft."""
    arm = random_arm(np.random.default_rng(3))
    kinematics = arm.kinematics()
    chosen = kind(kinematics)
    for qp in problems(2, 5, arm=arm):
        x, T = solve(chosen, qp).x, chosen.period
        here, there = (
            [function(q).full().ravel() for function in (kinematics.tip, kinematics.wrist)]
            for q in (qp.q, qp.q + T * x)
        )
        tip, wrist = (np.array(there) - here) / T
        np.testing.assert_allclose(tip, qp.v_tip, atol=1e-6)
        across = qp.reduced().lift[3:, 3:]
        np.testing.assert_allclose(across @ wrist, across @ qp.v_wrist, atol=1e-6)
        assert np.abs(qp.A @ x - qp.b).max() > 1e-6


def test_nonlinear_solvers_use_the_given_gradient(robot, regular_poses):
    """The subproblem's gradient may differ from the gradient of mu."""
    rng = np.random.default_rng(11)
    chosen = create("nlp-sqp", kinematics=robot.kinematics())
    for q in regular_poses(4):
        state, ends = robot.state(q), 0.5 * np.ones(robot.n)
        for gradient in (state.grad_mu, -state.grad_mu, rng.normal(size=robot.n) * np.abs(state.grad_mu).max()):
            zero = np.zeros(3)
            qp = NullSpaceQP(state.J_tip, state.J_wrist, zero, zero, gradient, -ends, ends, regularization=1e-3, q=q)
            best = create("exact").start(qp).solve(qp)
            np.testing.assert_allclose(solve(chosen, qp).x, best.x, atol=0.05)
