"""The largest mu of all poses with one tip and wrist: nothing that other means find is above it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from moc_opt import core
from moc_opt.planning.pose_map import SCANNED, largest_mu
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots.inverse_kinematics import solve_pose
from moc_opt.robots.model import RobotModel, load_robot
from tests.conftest import Array
from tests.planning.arms import build


def polished(robot: RobotModel, q: Array, tip: Array, wrist: Array) -> Array:
    """Climb mu with a general nonlinear program that knows nothing of self-motions."""
    free = robot.moves.any(axis=0)

    def state(x: Array):
        pose = q.copy()
        pose[free] = x
        return robot.state(pose)

    # Five of the six equations: a rigid tool makes one follow from the others.
    rows = np.linalg.svd(robot.state(q).A)[0][:, :5].T
    found = minimize(
        lambda x: (-state(x).mu, -state(x).grad_mu[free]), q[free], jac=True, method="SLSQP",
        bounds=list(zip(robot.q_min[free], robot.q_max[free], strict=True)),
        constraints={
            "type": "eq", "fun": lambda x: rows @ np.concatenate([state(x).tip - tip, state(x).wrist - wrist]),
            "jac": lambda x: rows @ state(x).A[:, free],
        }, options={"maxiter": 200, "ftol": 1e-12},
    )  # fmt: skip
    pose = q.copy()
    pose[free] = found.x
    return pose


def elsewhere(robot: RobotModel, q: Array, starts: int, seed: int) -> float:
    """The best mu of random inverse kinematics at the tip and wrist of q, the best eight polished."""
    s, rng = robot.state(q), np.random.default_rng(seed)
    drawn = rng.uniform(robot.q_min, robot.q_max, (starts, robot.n))
    placed = [solve_pose(robot, start, s.tip, s.wrist) for start in drawn]
    poses = sorted((p.q for p in placed if p.found), key=lambda pose: -robot.state(pose).mu)
    for pose in [polished(robot, pose, s.tip, s.wrist) for pose in poses[:8]]:
        there = robot.state(np.clip(pose, robot.q_min, robot.q_max))
        if max(np.abs(there.tip - s.tip).max(), np.abs(there.wrist - s.wrist).max()) < 1e-7:
            poses.append(there.q)
    return max(robot.state(pose).mu for pose in [*poses, q])


@pytest.mark.parametrize(("name", "method"), [
    ("lwr4", SCANNED), ("iiwa14", SCANNED), ("panda", "best found of 96 starts"), ("gen3", "best found of 96 starts"),
    ("xarm7", "best found of 96 starts"), ("lwr4_rail", "best found of 96 starts"),
])  # fmt: skip
def test_random_inverse_kinematics_find_nothing_better(name: str, method: str) -> None:
    """Beyond 1 %, and on the whole nothing at all: a basin of a few percent of the starts can be missed."""
    robot, rng = load_robot(name), np.random.default_rng(21)
    poses = [robot.data.q_home, *rng.uniform(robot.q_min, robot.q_max, (3, robot.n))]
    gaps = []
    for k, q in enumerate(poses):
        found = largest_mu(robot, q[None])
        assert found.method == method
        other = elsewhere(robot, q, 100, seed=k)
        gaps.append(found.mu[0] / other - 1.0)
        assert found.mu[0] >= robot.state(q).mu
    assert min(gaps) > -1e-2
    assert np.median(gaps) > -1e-6


@pytest.mark.parametrize("name", ["lwr4_rail", "odd"])
def test_with_two_freedoms_one_curve_is_not_all(name: str, odd_robot: RobotModel) -> None:
    robot = odd_robot if name == "odd" else load_robot(name)
    rng = np.random.default_rng(4)
    shares = []
    for q in [robot.data.q_home, *rng.uniform(0.7 * robot.q_min, 0.7 * robot.q_max, (3, robot.n))]:
        shares.append(self_motion(robot, q).mu_best / largest_mu(robot, q[None]).mu[0])
    assert max(shares) < 1.0 + 1e-6
    assert min(shares) < 0.97


def test_sixteen_joints(tmp_path: Path) -> None:
    turns = [((0, 0, 0.1), (0, 0, 0)), *[((0, 0, 0.08), (sign * np.pi / 2, 0, 0)) for sign in 7 * (1, -1) + (1,)]]
    robot = build(tmp_path, {
        "joints": turns, "q_max": np.full(16, 1.8), "v_max": np.full(16, 2.0), "wrist": (0, 0, 0),
        "mount": (0, 0, 0.05), "home": np.full(16, 0.2),
    })  # fmt: skip
    q = np.random.default_rng(1).uniform(-0.8, 0.8, 16)
    found = largest_mu(robot, q[None])
    assert found.mu[0] > 1.05 * self_motion(robot, q).mu_best
    assert found.mu[0] >= elsewhere(robot, q, 20, seed=0) * (1.0 - 5e-3)


def test_points_of_a_path_share_their_maxima() -> None:
    """Along a path few starts a point do: what one point found, its neighbours before and behind it have too."""
    robot = load_robot("xarm7")
    curve = np.linspace(0.0, 0.02, 12)[:, None] + robot.data.q_home
    alone = np.array([largest_mu(robot, q[None], starts=300).mu[0] for q in curve])
    found = largest_mu(robot, curve, starts=48)
    assert found.method == f"best found of {48 + 11 * 6} starts"
    np.testing.assert_allclose(found.mu, alone, rtol=1e-6)


def test_the_same_seed_finds_the_same_and_poses_beyond_a_limit_are_put_inside(odd_robot: RobotModel) -> None:
    q = np.array(odd_robot.data.q_home)
    q[0] = odd_robot.q_max[0] + 0.1
    one, two = (largest_mu(odd_robot, q[None], starts=20, seed=3) for _ in range(2))
    assert one == two
    inside = np.clip(q, odd_robot.q_min, odd_robot.q_max)
    np.testing.assert_array_equal(one.mu, largest_mu(odd_robot, inside[None], starts=20, seed=3).mu)


# --- the climb itself ---


def ascended(robot: RobotModel, start: Array, target: Array) -> tuple[Array, float]:
    """Where a climb from a start ends that keeps tip and wrist at a target (2,3), and mu there."""
    q, mu = start[None].copy(), np.empty(1)
    core.ascend(robot.arm, np.array(robot.q_min), np.array(robot.q_max), target, None, q, mu)
    return q[0], float(mu[0])


def steepest(robot: RobotModel, q: Array) -> float:
    """The largest slope of mu along a direction in [-1, 1]^n that keeps tip, wrist and limits, by HiGHS."""
    s = robot.state(q)
    low = np.where(q <= robot.q_min + 1e-6, 0.0, -1.0)
    high = np.where(q >= robot.q_max - 1e-6, 0.0, 1.0)
    across = np.linalg.svd(s.A)[2][:5]
    found = linprog(-s.grad_mu, A_eq=across, b_eq=np.zeros(5), bounds=list(zip(low, high, strict=True)))
    assert found.status == 0
    return float(-found.fun)


@pytest.mark.parametrize("name", ["panda", "lwr4_rail", "odd"])
def test_an_ascent_ends_at_a_maximum_inside_the_limits(name: str, odd_robot: RobotModel) -> None:
    robot = odd_robot if name == "odd" else load_robot(name)
    rng = np.random.default_rng(8)
    at_limits, slopes = 0, []
    for start in rng.uniform(robot.q_min, robot.q_max, (25, robot.n)):
        before = robot.state(start)
        q, mu = ascended(robot, start, np.array([before.tip, before.wrist]))
        there, active = robot.state(q), robot.moves.any(axis=0)
        np.testing.assert_allclose([there.tip, there.wrist], [before.tip, before.wrist], atol=1e-9)
        assert np.all((robot.q_min <= q) & (q <= robot.q_max))
        assert mu == pytest.approx(there.mu, rel=1e-12)
        assert mu >= before.mu - 1e-12
        slopes.append(steepest(robot, q) / np.abs(before.grad_mu).max())
        at_limits += bool(((q == robot.q_min) | (q == robot.q_max))[active].any())
    assert max(slopes) < 3e-2
    assert np.median(slopes) < 1e-3
    assert at_limits  # some of them end there, where what is held decides


def test_a_point_out_of_reach_is_told(odd_robot: RobotModel) -> None:
    s = odd_robot.state(odd_robot.data.q_home)
    assert ascended(odd_robot, np.array(s.q), np.array([s.tip, s.wrist]) + 10.0)[1] == -1.0
