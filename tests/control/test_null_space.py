"""Level 3: the damper's box, a wrist velocity that fits the tool, the null space, the torque, the fallback."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import subspace_angles
from scipy.optimize import lsq_linear

from moc_opt.control import ControlSettings, tick
from moc_opt.control import null_space as level3
from moc_opt.control.law import law_of, law_views
from moc_opt.errors import ControlError, ScenarioError
from moc_opt.model.robot_model import load_robot
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario, run
from moc_opt.trace.oscillation import LIMIT_RAD_PER_S, shaking
from tests.control.torques import of, subproblem, third

BOTH = pytest.mark.parametrize("form", ["compiled", "plain"])
SEEDS = st.integers(0, 2**32 - 1)


def damper(q, q_min, q_max, v_max, k0, form="compiled"):
    lower, upper = np.empty(len(q)), np.empty(len(q))
    of(level3.velocity_damper, form)(q, np.array([q_min, q_max, v_max]), k0, lower, upper)
    return lower, upper


def limits(rng, n=7):
    q_min = -rng.uniform(0.5, 3.0, n)
    return q_min, q_min + rng.uniform(0.5, 6.0, n), rng.uniform(0.1, 4.0, n)


# --- the box ---


@BOTH
@settings(max_examples=100)
@given(seed=SEEDS, k0=st.floats(1e-3, 100.0))
def test_damper_inside_the_limits_is_the_formula(form, seed, k0):
    rng = np.random.default_rng(seed)
    q_min, q_max, v_max = limits(rng)
    q = rng.uniform(q_min, q_max)
    lower, upper = damper(q, q_min, q_max, v_max, k0, form)
    np.testing.assert_allclose(lower, np.maximum(-v_max, -k0 * (q - q_min)), rtol=1e-15)
    np.testing.assert_allclose(upper, np.minimum(v_max, -k0 * (q - q_max)), rtol=1e-15)
    assert (lower <= 0.0).all()
    assert (upper >= 0.0).all()


@BOTH
@settings(max_examples=100)
@given(seed=SEEDS, k0=st.floats(1e-3, 100.0))
def test_damper_never_crosses_and_leads_back(form, seed, k0):
    rng = np.random.default_rng(seed)
    q_min, q_max, v_max = limits(rng)
    q = rng.uniform(q_min - 2.0, q_max + 2.0)
    lower, upper = damper(q, q_min, q_max, v_max, k0, form)
    assert (lower <= upper).all()
    assert (np.abs(lower) <= v_max).all()
    assert (np.abs(upper) <= v_max).all()
    assert (lower[q < q_min] > 0.0).all()
    assert (upper[q > q_max] < 0.0).all()


@settings(max_examples=100)
@given(seed=SEEDS, k0=st.floats(0.1, 400.0))
def test_no_velocity_of_the_box_leaves_the_limits(seed, k0):
    """q + T x stays inside for any x in the box, as long as k0 T <= 1."""
    rng = np.random.default_rng(seed)
    q_min, q_max, v_max = limits(rng)
    q = rng.uniform(q_min, q_max)
    for _ in range(200):
        lower, upper = damper(q, q_min, q_max, v_max, k0)
        q = q + 0.002 * np.where(rng.random(7) < 0.5, lower, upper)
        assert (q >= q_min - 1e-12).all()
        assert (q <= q_max + 1e-12).all()


def test_box_limits(robot):
    found = level3.box_limits(robot.q_min, robot.q_max, robot.v_max, margin=0.1, speed_fraction=0.25)
    np.testing.assert_array_equal(found, [robot.q_min + 0.1, robot.q_max - 0.1, 0.25 * robot.v_max])
    with pytest.raises(ControlError, match=r"limit_margin_rad = 3.0: nothing is left of joint 2 .* less than 2.09"):
        level3.box_limits(robot.q_min, robot.q_max, robot.v_max, margin=3.0)


def test_a_sliding_joint_has_its_margin_in_metres():
    rail = load_robot("lwr4_rail")
    margins = ControlSettings(limit_margin_rad=0.2, limit_margin_m=0.03).limit_margins(rail.chain.prismatic)
    np.testing.assert_array_equal(margins, [0.03, *[0.2] * 7])
    found = level3.box_limits(rail.q_min, rail.q_max, rail.v_max, margin=margins)
    np.testing.assert_allclose(found[0] - rail.q_min, margins, rtol=0, atol=1e-15)
    with pytest.raises(ControlError, match=r"limit_margin_rad = 0.6: nothing is left of joint 1 .* less than 0.5 "):
        level3.box_limits(rail.q_min, rail.q_max, rail.v_max, margin=np.where(rail.chain.prismatic, 0.6, 0.2))
    lower = law_views.py_func(law_of(ControlSettings(limit_margin_m=0.03), rail), 8).limits[0]
    np.testing.assert_allclose(lower - rail.q_min, [0.03, *[0.15] * 7], rtol=0, atol=1e-15)


def towards_a_limit(q, preset="nominal", **control):
    """Four seconds of self-motion at rest."""
    return run(
        Scenario(
            start={"q_rad": q.tolist(), "swivel": 0.5}, plant={"preset": preset}, duration_s=4.0,
            task={"wait_s": 5.0}, control=control, judge=False, bound_samples=0,
        )
    )  # fmt: skip


@pytest.mark.parametrize("preset", ["nominal", "realistic"])
@pytest.mark.parametrize("number", [13, 25])
def test_closed_loop_stops_before_the_wall(number, preset, robot, regular_poses):
    """From these two poses mu grows right up to a joint limit: the box must stop the arm before the guard does."""
    trace = towards_a_limit(regular_poses(30)[number], preset)
    room = np.minimum(robot.q_max - trace.q_rad, trace.q_rad - robot.q_min)
    assert trace.mu[-1] > 1.15 * trace.mu[0]
    assert 0.15 < room.min() < 0.17
    assert (trace.status == "solved").all()
    assert not trace.limited.any()
    assert trace.meta["ended"] == "completed"
    assert trace.tip_error_m.max() < 2e-3


def test_a_box_up_to_the_limit_presses_into_the_wall(robot, regular_poses):
    """Why the margin is there: box and guard disagree, and the tip pays for it."""
    trace = towards_a_limit(regular_poses(30)[13], limit_margin_rad=0.0)
    assert trace.limited.any()
    assert trace.tip_error_m.max() > 4e-3  # twice what is allowed with the margin


def test_a_wall_inside_the_box_is_refused():
    with pytest.raises(ScenarioError, match=r"guard.position_margin_rad = 0.2: .*limit_margin_rad = 0.15; set"):
        Scenario(guard={"position_margin_rad": 0.2})
    with pytest.raises(ScenarioError, match=r"guard.position_margin_m = 0.1: .*limit_margin_m = 0.05; set"):
        Scenario(guard={"position_margin_m": 0.1})
    Scenario(guard={"position_margin_rad": 0.2}, control={"limit_margin_rad": 0.2})
    Scenario(guard={"position_margin_rad": 0.2}, control={"law": "dcac"})  # no box
    Scenario(guard={"position_margin_rad": 0.2}, control={"preset": "paper"})  # the paper's box, on purpose


# --- references that a rigid tool can follow ---


@BOTH
@settings(max_examples=100)
@given(seed=SEEDS)
def test_consistent_wrist_velocity(form, seed):
    rng = np.random.default_rng(seed)
    v_tip, v_wrist, u = rng.normal(size=(3, 3))
    u /= np.linalg.norm(u)
    found = of(level3.consistent_wrist_velocity, form)(v_tip, v_wrist, u)
    assert abs(u @ (v_tip - found)) < 1e-14 * (1.0 + np.abs(v_tip).max() + np.abs(v_wrist).max())
    change = found - v_wrist
    np.testing.assert_allclose(change - (u @ change) * u, 0.0, atol=1e-14)  # only along the tool
    again = of(level3.consistent_wrist_velocity, form)(v_tip, found, u)
    np.testing.assert_allclose(again, found, atol=1e-14)


@BOTH
def test_subproblem_of_a_tick(form, robot, regular_poses):
    rng = np.random.default_rng(1)
    box, weights = np.array([robot.q_min, robot.q_max, robot.v_max]), np.array([0.01, 0.02, 0.003, 1e-5])
    for q in regular_poses(8):
        s = robot.state(q, rng.uniform(-1.0, 1.0, 7))
        tip_ref = rng.normal(size=(3, 3)) * 0.05
        trocar = np.array(
            [s.tip - 0.15 * s.tool_direction + rng.normal(size=3) * 1e-3, rng.normal(size=3) * 0.01]
        )
        found = NullSpaceQP.from_row(subproblem(s, tip_ref, trocar, form, limits=box, weights=weights, k0=2.0))

        to = trocar[0] - s.tip
        e = to / np.linalg.norm(to)
        turn = (np.eye(3) - np.outer(e, e)) @ (trocar[1] - tip_ref[1]) / np.linalg.norm(to)
        v_wrist = tip_ref[1] + s.tool_span * turn
        v_wrist += s.tool_direction @ (tip_ref[1] - v_wrist) * s.tool_direction
        lower, upper = damper(q, *box, 2.0)
        wanted = NullSpaceQP(
            s.J_tip, s.J_wrist, tip_ref[1], v_wrist, s.grad_mu, lower, upper, 0.01, 0.02, 0.003, 1e-5, q
        )  # fmt: skip
        np.testing.assert_allclose(found.row, wanted.row, rtol=0.0, atol=1e-12)
        slack = np.linalg.lstsq(found.A, found.b, rcond=None)[0]
        np.testing.assert_allclose(found.A @ slack, found.b, atol=1e-12)  # six rows of rank five, and it fits


@BOTH
def test_near_the_loss_of_the_shaft_the_climb_leads_away(form, robot):
    margin = 0.025
    for bend in (0.05, 0.2, 0.4, 0.8):  # joint 6 straightens the wrist: there the shaft loses a direction
        s = robot.state(np.array([0.4, 0.9, 0.3, 1.2, 0.6, bend, 0.0]))
        tip_ref, trocar = np.zeros((3, 3)), np.array([s.tip - 0.15 * s.tool_direction, np.zeros(3)])
        gradients = [
            NullSpaceQP.from_row(subproblem(s, tip_ref, trocar, form, shaft_margin=m)).grad_mu for m in (0.0, margin)
        ]
        np.testing.assert_array_equal(gradients[0], s.grad_mu)  # the paper's
        weight = 0.1 * max(0.0, 1.0 - s.mu_shaft / margin) * s.mu_shaft / (s.mu_shaft**2 + 0.0025**2)
        assert (weight > 0.0) == (s.mu_shaft < margin)
        np.testing.assert_allclose(gradients[1], s.grad_mu + weight * s.grad_mu_shaft, rtol=1e-12)
    assert s.mu_shaft > margin


@BOTH
def test_near_the_loss_of_the_shaft_the_box_opens_towards_the_whole_speed(form, robot):
    margin, share = 0.025, 0.5
    for bend in (0.0, 0.05, 0.2, 0.3, 0.4, 0.8):
        q = np.array([0.4, 0.9, 0.3, 1.2, 0.6, bend, 0.0])
        s = robot.state(q)
        tip_ref, trocar = np.zeros((3, 3)), np.array([s.tip - 0.15 * s.tool_direction, np.zeros(3)])
        limits = np.array([robot.q_min, robot.q_max, share * robot.v_max])
        about = {"shaft_margin": margin, "spare_speed": 1.0 / share - 1.0, "limits": limits, "k0": 2.0}
        found = NullSpaceQP.from_row(subproblem(s, tip_ref, trocar, form, **about))
        allowed = share + (1.0 - share) * min(1.0, max(0.0, 3.0 * (1.0 - s.mu_shaft / margin)))
        lower, upper = damper(q, robot.q_min, robot.q_max, allowed * robot.v_max, 2.0)
        np.testing.assert_allclose(found.lower, lower, rtol=1e-12)
        np.testing.assert_allclose(found.upper, upper, rtol=1e-12)
    assert s.mu_shaft > margin


@pytest.mark.parametrize("length", [0.15, 0.3, 0.6])
def test_the_shafts_margin_grows_with_the_square_of_the_lever(length):
    """With the tip held the wrist moves by its distance from the tip times the shaft's turn, in two directions."""
    robot = load_robot("gen3", tool_length=length)
    lever = length + 0.061525 + 0.10593
    law = law_views.py_func(law_of(ControlSettings(shaft_margin=0.2, speed_fraction=0.4), robot), 7)
    assert law.shaft_margin == pytest.approx(0.2 * lever**2)
    assert law.spare_speed == pytest.approx(1.5)
    paper = law_views.py_func(law_of(ControlSettings.preset("paper"), robot), 7)
    assert (paper.shaft_margin, paper.spare_speed) == (0.0, 0.0)


def test_the_push_off_the_loss_of_the_shaft_begins_at_the_margin_and_fades_where_it_has_no_direction():
    pushes = [tick.shaft_push(0.02 * share, 0.02) for share in (1.5, 1.0, 1.0 - 1e-9, 0.5, 0.2, 0.1)]
    assert pushes[:2] == [0.0, 0.0]
    assert 0.0 < pushes[2] < 1e-7
    assert pushes[2:] == sorted(pushes[2:])
    assert pushes[-1] > 10.0
    assert tick.shaft_push(0.0, 0.02) == 0.0
    assert tick.shaft_push(1e-9, 0.02) < 1e-3


def test_a_climb_towards_the_loss_of_the_shaft_jerks_the_arm_and_is_kept_from_it():
    """From this pose mu grows towards a straight wrist, where joint 5 has to turn ever faster."""
    trial = Scenario(seed=707, start={"pose": "random"}, judge=False, bound_samples=0)
    lost, kept = run(trial.change(control={"shaft_margin": 0.0})), run(trial)
    assert lost.meta["ended"] == kept.meta["ended"] == "completed"
    jerk = shaking(lost, "v_rad_per_s")
    assert jerk.joint == 4
    assert jerk.rms > 2.0 * LIMIT_RAD_PER_S
    assert shaking(kept, "v_rad_per_s").rms < 0.25 * LIMIT_RAD_PER_S
    assert kept.rcm_error_m.max() < 0.6 * lost.rcm_error_m.max()


# --- the null space ---


def check_basis(Z, A, tolerance=1e-12):
    np.testing.assert_allclose(Z @ Z.T, np.eye(len(Z)), atol=tolerance)
    np.testing.assert_allclose(A @ Z.T, 0.0, atol=tolerance)


def test_null_space_of_an_arm(robot, regular_poses):
    for q in regular_poses(20):
        A = robot.state(q).A
        Z = level3.null_space(A)
        assert Z.shape == (2, 7)  # the swivel of the elbow, and joint 7
        check_basis(Z, A)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_rank_does_not_depend_on_the_unit_of_length(scale, robot, regular_poses):
    for q in regular_poses(5):
        A = scale * robot.state(q).A
        assert level3.null_space(A).shape == (2, 7)
        assert level3.null_space(scale * straight_elbow(robot, 0.0).A).shape == (3, 7)


@settings(max_examples=60)
@given(seed=SEEDS, rows=st.integers(1, 6), n=st.integers(6, 9))
def test_null_space_lies_closest_to_the_one_it_is_given(seed, rows, n):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, n))
    r = n - rows
    if r == 0:
        return
    like = level3.null_space(A)
    turned = np.linalg.qr(rng.normal(size=(r, r)))[0] @ like
    found = level3.null_space(A, like=turned)
    check_basis(found, A)
    np.testing.assert_allclose(found, turned, atol=1e-10)  # the same kernel: the same basis comes back


def walk(robot, q, steps=400, seed=0):
    """States along a smooth motion through q."""
    rng = np.random.default_rng(seed)
    swing, phase = rng.uniform(0.2, 0.5, 7), rng.uniform(0.0, 2.0 * np.pi, 7)
    return [robot.state(q + swing * (np.sin(phase + 0.004 * k) - np.sin(phase))) for k in range(steps)]


@BOTH
def test_carried_basis_turns_no_further_than_the_kernel(form, robot, regular_poses):
    steps, rng = 400 if form == "compiled" else 40, np.random.default_rng(3)
    for q in regular_poses(3, seed=2):
        states = walk(robot, q, steps)
        # turned, so that no row is the idle joint alone, which the others never disturb
        Z = np.linalg.qr(rng.normal(size=(2, 2)))[0] @ level3.null_space(states[0].A)
        for s in states[1:]:
            before = Z.copy()
            assert of(level3.follow_null_space, form)(np.array(s.A), np.array(s.tool_direction), Z)
            check_basis(Z, s.A)
            turn = np.sin(subspace_angles(before.T, Z.T)[0])
            assert np.linalg.norm(Z - before, 2) < 1.2 * turn + 1e-12


def test_carried_basis_keeps_its_sign_where_a_fresh_one_has_its_own(robot, regular_poses):
    """Whatever basis it starts from, the carried one stays near; a decomposition forgets it at once."""
    rng = np.random.default_rng(4)
    states = walk(robot, regular_poses(1, seed=3)[0], 100)
    fresh = level3.null_space(states[1].A)
    jumps = []
    for _ in range(8):
        Z = np.linalg.qr(rng.normal(size=(2, 2)))[0] @ level3.null_space(states[0].A)
        first = Z.copy()
        level3.follow_null_space(states[1].A, states[1].tool_direction, Z)
        assert np.linalg.norm(Z - first, 2) < 0.02
        jumps.append(np.linalg.norm(fresh - first, 2))
    assert max(jumps) > 1.0


def test_torque_does_not_depend_on_the_basis(robot, regular_poses):
    rng = np.random.default_rng(5)
    s = robot.state(regular_poses(1)[0])
    Z, push = level3.null_space(s.A), rng.normal(size=7)
    turned = np.linalg.qr(rng.normal(size=(2, 2)))[0] @ Z
    np.testing.assert_allclose(
        level3.self_motion_torque(s.M, Z, push), level3.self_motion_torque(s.M, turned, push), atol=1e-12
    )


def straight_elbow(robot, angle):
    q = robot.data.q_home.copy()
    q[3] = angle
    return robot.state(q)


def test_following_gives_up_at_the_straight_elbow_and_recovers(robot):
    """At the straight elbow the wrist loses a direction and the kernel gains one: rank 4 instead of 5."""
    angles = np.concatenate([np.linspace(0.05, 0.0, 26), np.linspace(0.0, -0.05, 26)[1:]])
    Z = level3.null_space(straight_elbow(robot, 0.052).A)
    ranks, failures = [], 0
    for angle in angles:
        s = straight_elbow(robot, angle)
        if not level3.follow_null_space(s.A, s.tool_direction, Z):
            failures += 1
            Z = level3.null_space(s.A, like=Z)
        check_basis(Z, s.A, 1e-9)
        ranks.append(7 - len(Z))
    assert set(ranks) == {4, 5}
    assert ranks[0] == ranks[-1] == 5
    assert 1 <= failures <= 4


def test_following_is_exact_near_the_straight_elbow(robot):
    """Where A A^T has a condition of 1e9, from the basis of a pose half a radian away: the second pass does it."""
    rng = np.random.default_rng(0)
    s = straight_elbow(robot, 3e-4)
    for _ in range(5):
        Z = level3.null_space(robot.state(s.q + 0.2 * rng.normal(size=7)).A)
        assert level3.follow_null_space(s.A, s.tool_direction, Z)
        np.testing.assert_allclose(s.A @ Z.T, 0.0, atol=1e-15)
        np.testing.assert_allclose(Z @ Z.T, np.eye(2), atol=1e-14)


def test_following_gives_up_before_the_rows_are_dependent(robot):
    """What the others leave of a row, squared and over the row's own square: 4.6e-10 at 3e-5 rad, 5.1e-9 at 1e-4."""
    for angle, follows in ((1e-4, True), (3e-5, False), (1e-5, False)):
        s = straight_elbow(robot, angle)
        Z = level3.null_space(straight_elbow(robot, 0.05).A)
        assert level3.follow_null_space(s.A, s.tool_direction, Z) == follows


@BOTH
@pytest.mark.parametrize(("share", "follows"), [(0.9, True), (0.55, True), (0.45, False), (0.0, False)])
def test_following_needs_half_of_every_row(share, follows, form, robot, regular_poses):
    """A basis of which the new kernel holds less is not carried over: there is nothing to lie close to."""
    s = robot.state(regular_poses(1)[0])
    A, kernel = np.array(s.A), level3.null_space(s.A)
    across = np.linalg.svd(A)[2][0]  # a direction that moves the tip
    for row in (0, 1):
        Z = kernel.copy()
        Z[row] = share * kernel[row] + np.sqrt(1.0 - share**2) * across
        assert of(level3.follow_null_space, form)(A, np.array(s.tool_direction), Z) == follows
        if follows:
            check_basis(Z, A)
            np.testing.assert_allclose(Z, kernel, atol=1e-12)


def test_following_fails_rather_than_returning_nonsense(robot, regular_poses):
    s = straight_elbow(robot, 0.0)
    Z = np.array(level3.null_space(robot.state(regular_poses(1)[0]).A))
    assert not level3.follow_null_space(s.A, s.tool_direction, Z)
    assert not level3.follow_null_space(np.full((6, 7), np.nan), s.tool_direction, Z)


# --- the torque ---

K_N2 = np.array([80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0])
D_N2 = np.array([6.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0])


@BOTH
def test_torque_against_numpy(form, robot, regular_poses):
    rng = np.random.default_rng(6)
    for q in regular_poses(8):
        s = robot.state(q, rng.uniform(-1.0, 1.0, 7))
        Z, x = level3.null_space(s.A), rng.normal(size=7)
        found = third(s, Z, x, K_N2, D_N2, 0.7, form)
        M = s.M
        wanted = 0.7 * M @ Z.T @ np.linalg.inv(Z @ M @ Z.T) @ Z @ (np.diag(K_N2) @ (x - s.v) - np.diag(D_N2) @ s.v)
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10)


PER_JOINT = st.lists(st.floats(0.0, 200.0), min_size=7, max_size=7)


@settings(max_examples=60)
@given(seed=SEEDS, gain=PER_JOINT, damping=PER_JOINT)
def test_level_three_moves_neither_tip_nor_wrist(robot, seed, gain, damping):
    """Whatever the gains of the joints are: they act before the projection."""
    rng = np.random.default_rng(seed)
    s = robot.state(robot.random_regular_pose(rng), rng.uniform(-1.0, 1.0, 7))
    tau = third(s, level3.null_space(s.A), rng.normal(size=7), gain, damping)
    scale = np.linalg.norm(s.A @ np.linalg.inv(s.M), 2) * (np.linalg.norm(tau) + max(*gain, *damping))
    assert np.linalg.norm(s.A @ np.linalg.solve(s.M, tau)) <= 1e-10 * scale


def test_level_three_gives_more_than_rounding(robot, regular_poses):
    rng = np.random.default_rng(7)
    for q in regular_poses(30):
        s = robot.state(q, rng.uniform(-1.0, 1.0, 7))
        tau = third(s, level3.null_space(s.A), rng.normal(size=7), K_N2, D_N2)
        assert np.linalg.norm(tau) > 1.0


def test_self_motion_projector_is_idempotent(robot, regular_poses):
    for q in regular_poses(10):
        s = robot.state(q)
        Z = level3.null_space(s.A)
        N = np.array([level3.self_motion_torque(s.M, Z, e) for e in np.eye(7)]).T
        np.testing.assert_allclose(N @ N, N, atol=1e-10)


def test_answer_is_followed_along_the_self_motion(robot, regular_poses):
    """The torque speeds the arm up towards x, measured along the kernel; damping slows it down."""
    rng = np.random.default_rng(8)
    for q in regular_poses(10):
        s = robot.state(q, rng.uniform(-0.5, 0.5, 7))
        Z, x = level3.null_space(s.A), rng.normal(size=7)
        gain = third(s, Z, x, 80.0, 0.0)
        assert (Z @ np.linalg.solve(s.M, gain)) @ (Z @ (x - s.v)) > 0.0
        slow = third(s, Z, np.array(s.v), 80.0, 5.0)
        assert (Z @ np.linalg.solve(s.M, slow)) @ (Z @ s.v) < 0.0


def test_no_null_space_no_torque(robot):
    s = robot.state(robot.data.q_home)
    np.testing.assert_array_equal(level3.self_motion_torque(s.M, np.zeros((0, 7)), np.ones(7)), np.zeros(7))


# --- the fallback ---


@BOTH
def test_least_violation_against_scipy(form, robot, regular_poses):
    rng = np.random.default_rng(9)
    count = 30 if form == "compiled" else 4
    for number, q in enumerate(regular_poses(count)):
        s = robot.state(q)
        lower, upper = -rng.uniform(0.02, 0.5, 7), rng.uniform(0.02, 0.5, 7)
        if number % 2:  # beyond a limit: the box asks for a velocity back inside, for idle joint 7 too
            lower[[1, 6]] = upper[[1, 6]] / 2.0
        v_tip = 0.3 * rng.normal(size=3)
        v_wrist = level3.consistent_wrist_velocity(v_tip, 0.3 * rng.normal(size=3), s.tool_direction)
        A, b = np.array(s.A), np.concatenate([v_tip, v_wrist])
        x = of(level3.least_violation, form)(A, b, lower, upper, 50)
        assert (x >= lower).all()
        assert (x <= upper).all()
        best = lsq_linear(A, b, (lower, upper), tol=1e-12).x
        assert np.linalg.norm(A @ x - b) < 1.01 * np.linalg.norm(A @ best - b) + 1e-6


@settings(max_examples=40)
@given(seed=SEEDS)
def test_least_violation_gets_no_worse_with_more_sweeps(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(6, 7)), rng.normal(size=6) * 3.0
    A[:, 6] = 0.0  # a joint that moves nothing stays at rest
    lower, upper = -rng.uniform(0.1, 1.0, 7), rng.uniform(0.1, 1.0, 7)
    residuals = []
    for sweeps in (0, 1, 2, 5, 20):
        x = level3.least_violation(A, b, lower, upper, sweeps)
        assert x[6] == 0.0
        residuals.append(np.linalg.norm(A @ x - b))
    assert (np.diff(residuals) <= 1e-12).all()
    assert residuals[-1] < residuals[0]


def boxed(rng, robot, q, tight):
    """A and b of a pose, with a box around a point of A x = b that leaves the shortest one out as often as not."""
    s = robot.state(q)
    v_tip = 0.05 * rng.normal(size=3)
    v_wrist = level3.consistent_wrist_velocity(v_tip, 0.05 * rng.normal(size=3), s.tool_direction)
    A, b, Z = np.array(s.A), np.concatenate([v_tip, v_wrist]), level3.null_space(s.A)
    inside = np.linalg.lstsq(A, b, rcond=1e-9)[0] + 0.2 * rng.normal(size=len(Z)) @ Z
    return A, b, Z, inside - tight * rng.uniform(size=7), inside + tight * rng.uniform(size=7)


@BOTH
def test_the_smallest_self_motion_into_the_box(form, robot, odd_robot, regular_poses):
    """Against a bounded least-squares solver, on arms with one swivel and with two freedoms."""
    rng, moved = np.random.default_rng(10), 0
    for number, q in enumerate(regular_poses(40 if form == "compiled" else 4)):
        arm = robot if number % 2 else odd_robot
        pose = q if arm is robot else arm.random_regular_pose(rng)
        A, b, Z, lower, upper = boxed(rng, arm, pose, 0.2)
        found = of(level3.into_the_box, form)(A, b, Z, lower, upper, 500)
        shortest = np.linalg.lstsq(A, b, rcond=1e-9)[0]
        np.testing.assert_allclose(A @ found, 0.0, atol=1e-12)
        x = shortest + found
        assert (x >= lower - 1e-6).all()
        assert (x <= upper + 1e-6).all()
        # min |x|^2 on A x = b in the box: the equations weigh so much that they hold
        heavy = np.vstack([1e4 * A, np.eye(7)])
        best = lsq_linear(heavy, np.concatenate([1e4 * b, np.zeros(7)]), (lower, upper), tol=1e-14).x
        assert np.linalg.norm(x) <= np.linalg.norm(best) * (1 + 1e-4)
        np.testing.assert_allclose(x, best, atol=2e-4)
        moved += np.abs(found).max() > 1e-3
    assert moved > 1


def test_no_self_motion_where_none_is_needed_or_none_helps(robot, regular_poses):
    rng = np.random.default_rng(11)
    A, b, Z, *_ = boxed(rng, robot, regular_poses(1)[0], 0.1)
    wide = np.full(7, 10.0)
    np.testing.assert_array_equal(level3.into_the_box(A, b, Z, -wide, wide, 50), np.zeros(7))
    for lower, upper in ((wide - 1.0, wide), (-wide, 1.0 - wide)):  # out of reach, above and below
        np.testing.assert_array_equal(level3.into_the_box(A, b, Z, lower, upper, 50), np.zeros(7))
    np.testing.assert_array_equal(level3.into_the_box(np.full((6, 7), np.nan), b, Z, -wide, wide, 50), np.zeros(7))


@BOTH
def test_a_joint_that_has_no_part_in_the_self_motion_is_left_alone(form):
    """Its column of Z is zero: nothing may be divided by it, and the others still find their way into the box."""
    rng = np.random.default_rng(13)
    Z = np.zeros((1, 7))
    Z[0, [0, 1, 2, 4, 5, 6]] = rng.normal(size=6)
    Z /= np.linalg.norm(Z)
    A = np.linalg.qr(np.vstack([Z, rng.normal(size=(6, 7))]).T)[0].T[1:]  # orthonormal rows across Z
    shortest = rng.normal(size=7)
    shortest -= (Z @ shortest) @ Z
    wanted = shortest + 0.3 * Z[0]
    lower, upper = wanted - 0.01, wanted + 0.01
    found = of(level3.into_the_box, form)(A, A @ shortest, Z, lower, upper, 50)
    assert found[3] == 0.0
    assert (shortest + found >= lower - 1e-6).all()
    assert (shortest + found <= upper + 1e-6).all()
    assert np.linalg.norm(found) < 0.3
