"""The core's control law agrees with the same equations in NumPy."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from moc_opt import load_robot
from moc_opt.control.law_numbers import PROJECTORS
from moc_opt.qp.problem import fields
from moc_opt.robots import available_robots
from tests.control.torques import in_place, law, stand_in, subproblem, ticked, tracking
from tests.reference import law as reference

GAINS = (3000.0, 80.0, 800.0, 60.0)
LWR4 = load_robot()
INFEASIBLE, FAILED = 1, 2  # values of the core's moc_fault


@pytest.fixture(scope="module", params=[*available_robots(), "odd"])
def robot(request, odd_robot):
    return odd_robot if request.param == "odd" else load_robot(request.param)


def trials(robot, count=10):
    """Yield ((state, tip_ref, trocar), rng). The references are about 1 mm away from the arm's tip and shaft."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        state = robot.state(robot.random_regular_pose(rng), rng.uniform(-0.3, 0.3, robot.n))
        tip_ref, trocar = in_place(state)
        tip_ref += rng.normal(scale=[[1e-3], [0.03], [0.2]], size=(3, 3))
        yield (state, tip_ref, trocar + 1e-3 * rng.normal(size=(2, 3))), rng


@pytest.mark.parametrize("rcm_lambda", [0.0, 0.5])
@pytest.mark.parametrize("projector", PROJECTORS)
def test_tip_and_rcm_torques_agree_with_the_equations(robot, projector, rcm_lambda):
    for (s, tip_ref, trocar), _ in trials(robot):
        found = tracking(robot, s, tip_ref, trocar, GAINS, projector=PROJECTORS.index(projector), rcm_lambda=rcm_lambda)
        wanted = reference.tip_torque(s, *GAINS[:2], tip_ref)
        wanted += reference.rcm_torque(s, *GAINS[2:], trocar, projector, rcm_lambda)
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


def test_feedforward_gives_tip_the_acceleration_of_its_reference(robot):
    for (s, tip_ref, trocar), _ in trials(robot):
        found = tracking(robot, s, tip_ref, trocar, feedforward=True) - tracking(robot, s, tip_ref, trocar)
        np.testing.assert_allclose(found, reference.feedforward(s, tip_ref, trocar), rtol=1e-6, atol=1e-6)
        reached = s.A @ np.linalg.solve(s.M, found)
        np.testing.assert_allclose(reached[:3], tip_ref[2] - s.drift_tip, atol=1e-8)


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-7, 1e-5, -1e-4])
def test_feedforward_is_bounded_at_a_straight_elbow(angle):
    q = np.array(LWR4.data.q_home)
    q[3] = angle
    s = LWR4.state(q)
    tip_ref, trocar = in_place(s)
    tip_ref[2] = [0.1, -0.2, 0.3]
    found = tracking(LWR4, s, tip_ref, trocar, feedforward=True) - s.h
    assert np.abs(found).max() < 100.0
    np.testing.assert_allclose((s.A @ np.linalg.solve(s.M, found))[:3], tip_ref[2], atol=1e-7)


def test_subproblem_agrees_with_the_equations(robot):
    n, margin = robot.n, 0.175 * robot.state(robot.data.q_home).tool_span ** 2
    for (s, tip_ref, trocar), rng in trials(robot):
        k0, low, high = rng.uniform(0.1, 400.0), s.q - rng.uniform(-0.1, 1.0, n), s.q + rng.uniform(0.1, 1.0)
        parts = {"q_min": low, "q_max": high, "v_max": 0.5 * robot.v_max, "k0": k0}
        found = fields(subproblem(robot, s, tip_ref, trocar, shaft_margin=margin, spare_speed=1.0, **parts))
        v_T, v_W = reference.references(s, tip_ref, trocar)
        opened = min(1.0, reference.BOX_OPENS * max(0.0, 1.0 - s.mu_shaft / margin))
        lower, upper = reference.velocity_damper(s.q, low, high, 0.5 * robot.v_max * (1.0 + opened), k0)
        np.testing.assert_array_equal(found.A, s.A)
        np.testing.assert_allclose(found.b, np.concatenate([v_T, v_W]), atol=1e-14)
        pull = s.grad_mu + reference.shaft_push(s.mu_shaft, margin) * s.grad_mu_shaft
        np.testing.assert_allclose(found.pull, pull, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found.lower, lower, rtol=1e-12)
        np.testing.assert_allclose(found.upper, upper, rtol=1e-12)
        wanted = np.arange(1.0, n + 1.0)
        followed = fields(subproblem(robot, s, tip_ref, trocar, x_d=wanted, c2=1e-3, rho=1e-5))
        np.testing.assert_allclose(followed.pull, 1e-2 * wanted)
        np.testing.assert_array_equal(followed.grad_mu, s.grad_mu)


def test_third_level_accelerates_neither_tip_nor_wrist(robot):
    for (s, *_), rng in trials(robot):
        x, K, D = rng.normal(size=robot.n), rng.uniform(10, 120, robot.n), rng.uniform(0, 5, robot.n)
        found = ticked(robot, s, *in_place(s), x, K_N2=K, D_N2=D, fade=0.6)[0] - s.h
        np.testing.assert_allclose(found, 0.6 * reference.third_level(s, x, K, D), rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(s.A @ np.linalg.solve(s.M, found), 0.0, atol=1e-8)
        assert np.abs(found).max() > 1e-3


def test_observer_agrees_with_the_equations(robot):
    for (s, tip_ref, trocar), rng in trials(robot, 5):
        made = law(robot.n, robot.arm, observer_gain=25.0)
        made.start(s.q, s.v, tip_ref, trocar)
        integral, wanted = s.M @ s.v, np.zeros(robot.n)
        for _ in range(3):
            tau = rng.normal(size=robot.n)
            made.set_applied(tau)
            later = robot.state(s.q, s.v + 0.1 * rng.normal(size=robot.n))
            made.begin(later.q, later.v, tip_ref, trocar, None)
            integral, wanted = reference.observe(later, tau, 25.0, 0.002, integral, wanted)
            np.testing.assert_allclose(made.memory()[2], wanted, rtol=1e-8, atol=1e-8)


def test_pull_times_c2_over_rho_does_not_depend_on_c2_and_rho(robot):
    margin, below = 0.175 * robot.state(robot.data.q_home).tool_span ** 2, 0
    for (s, tip_ref, trocar), rng in trials(robot, 20):
        c2, rho = 10.0 ** rng.uniform(-5.0, 0.0, 2)
        parts = {"climbs": True, "c2": c2, "rho": rho, "shaft_margin": margin}
        found = c2 / rho * fields(subproblem(robot, s, tip_ref, trocar, **parts)).pull
        np.testing.assert_allclose(found, reference.scaled_climb(robot, s, margin), rtol=1e-4, atol=1e-4)
        below += s.mu_shaft < margin
    assert below > 0


@pytest.mark.parametrize("bend", [0.0, 1e-12])
def test_without_gradient_along_self_motion_the_pull_is_zero(bend):
    s = LWR4.state(np.array([0.2, 0.0, 0.0, bend, 0.0, 0.0, 0.0]))
    found = fields(subproblem(LWR4, s, *in_place(s), climbs=True, c2=1.0, rho=1.0)).pull
    np.testing.assert_array_equal(found, np.zeros(7))


def test_null_space_basis_changes_continuously_except_at_a_straight_elbow():
    q, sizes, before, made = np.array(LWR4.data.q_home), [], None, law(7, LWR4.arm)
    for angle in (0.1, 3e-12, *np.linspace(0.1, -0.1, 201)):  # at 3e-12 rad the rank is in doubt
        q[3] = angle
        s = LWR4.state(q)
        if before is None:
            made.start(q, s.v, *in_place(s))
        made.begin(q, s.v, *in_place(s), None)
        rows, Z, _ = made.memory()
        Z = Z[:rows]
        np.testing.assert_allclose(s.A @ Z.T, 0.0, atol=1e-9)
        np.testing.assert_allclose(Z @ Z.T, np.eye(len(Z)), atol=1e-9)
        if before is not None and len(Z) == len(before) and abs(angle) > 0.01:
            assert np.linalg.norm(Z - before, 2) < 0.1
        before = Z
        sizes.append(len(Z))
    assert sizes[0] == sizes[-1] == 2
    assert max(sizes) == 3  # at the straight elbow


def problem(rng, robot, tight=None):
    """Return a random subproblem: flat array, its parts, basis of ker A. With `tight`, bounds are near a feasible x."""
    s = robot.state(robot.random_regular_pose(rng))
    u, v_T, v_W = s.tool_direction, *(0.05 * rng.normal(size=(2, 3)))
    row, Z = np.full(11 * s.n + 10, np.nan), reference.null_space(s.A)
    part = fields(row)
    part.A[:], part.b[:] = s.A, np.concatenate([v_T, v_W + u * (u @ (v_T - v_W))])
    part.lower[:], part.upper[:] = -rng.uniform(0.02, 0.5, s.n), rng.uniform(0.02, 0.5, s.n)
    if tight is not None:
        inside = np.linalg.lstsq(s.A, part.b, rcond=1e-9)[0] + 0.2 * rng.normal(size=len(Z)) @ Z
        part.lower[:], part.upper[:] = inside - tight * rng.uniform(size=s.n), inside + tight * rng.uniform(size=s.n)
    return row, part, np.ascontiguousarray(Z)


def test_least_violation_agrees_with_scipy(odd_robot):
    rng = np.random.default_rng(9)
    for k in range(30):
        row, part, Z = problem(rng, LWR4 if k % 2 else odd_robot)
        part.b[:] *= 6.0
        if k % 3:  # the second joint has to move
            part.lower[1] = part.upper[1] / 2.0
        x = stand_in(row, Z, INFEASIBLE, "least-violation")
        assert (x >= part.lower).all()
        assert (x <= part.upper).all()
        best = lsq_linear(part.A, part.b, (part.lower, part.upper), tol=1e-12).x
        assert np.linalg.norm(part.A @ x - part.b) < 1.01 * np.linalg.norm(part.A @ best - part.b) + 1e-5


def test_smallest_self_motion_within_bounds_agrees_with_scipy(odd_robot):
    rng, moved = np.random.default_rng(10), 0
    for k in range(40):
        row, part, Z = problem(rng, LWR4 if k % 2 else odd_robot, tight=0.2)
        found = stand_in(row, Z, FAILED)
        x = np.linalg.lstsq(part.A, part.b, rcond=1e-9)[0] + found
        # a large weight enforces A x = b
        heavy, right = np.vstack([1e4 * part.A, np.eye(7)]), np.concatenate([1e4 * part.b, np.zeros(7)])
        best = lsq_linear(heavy, right, (part.lower, part.upper), tol=1e-14).x
        np.testing.assert_allclose(part.A @ found, 0.0, atol=1e-12)
        np.testing.assert_allclose(x, best, atol=5e-4)
        moved += np.abs(found).max() > 1e-3
    assert moved > 10


def test_no_unnecessary_self_motion_is_added():
    row, part, Z = problem(np.random.default_rng(11), LWR4, tight=0.1)
    wide = np.full(7, 10.0)
    for lower, upper in ((-wide, wide), (wide - 1.0, wide), (-wide, 1.0 - wide)):
        part.lower[:], part.upper[:] = lower, upper
        np.testing.assert_allclose(stand_in(row, Z, FAILED), np.zeros(7), atol=1e-14)
    for damaged in ((4, 2), ...):  # with NaN in A, no self-motion can be computed
        part.A[damaged] = np.nan
        np.testing.assert_array_equal(stand_in(row, Z, FAILED), np.zeros(7))
