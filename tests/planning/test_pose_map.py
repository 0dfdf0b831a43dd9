"""The pose map has every pose of the arm at each point of a path."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog, minimize

from moc_opt.errors import RobotError
from moc_opt.planning import pose_map
from moc_opt.planning.course import Targets
from moc_opt.planning.elbow import Elbow, wrapped
from moc_opt.planning.guides import margin_of
from moc_opt.planning.pose_map import SCANNED, closed_form, largest_mu, map_of, without_limits
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots.inverse_kinematics import solve_pose
from moc_opt.robots.model import link_frames, load_robot
from tests.planning.arms import IIWA14, H, at_poses, build, line_from, sixteen_joints, turned

JOINTS = IIWA14["joints"]


@pytest.fixture(scope="module", params=["lwr4", "iiwa14", "turned"])
def arm(request, tmp_path_factory):
    return turned(tmp_path_factory.mktemp("arm")) if request.param == "turned" else load_robot(request.param)


@pytest.fixture(scope="module")
def panda():
    robot = load_robot("panda")
    return robot, map_of(robot, robot.data.q_home, line_from(robot, robot.data.q_home))


def test_every_pose_of_the_map_agrees_with_the_model(arm):
    rng = np.random.default_rng(0)
    starts = np.array([arm.random_regular_pose(rng, margin=0.02) for _ in range(10)])
    found = map_of(arm, starts[0], at_poses(arm, starts), 180)
    q, shape = found.q_rad.reshape(-1, 7), (len(starts), 8, 180, 3)
    for places, targets in zip(arm.tool_along(q), (found.targets.tip, found.targets.wrist), strict=True):
        np.testing.assert_allclose(places.reshape(shape) - targets[:, None, None], 0.0, atol=1e-12)
    np.testing.assert_allclose(arm.mu_along(q), found.mu.ravel(), atol=1e-12)
    room = np.minimum(q - arm.q_min, arm.q_max - q)[:, :6].min(axis=1)
    np.testing.assert_allclose(room, found.room_rad.ravel(), atol=1e-12)
    axes = np.einsum("kjab,jb->kja", link_frames(arm, found.q_rad[3, 0])[1], arm.chain.axes)
    sines = np.linalg.norm(np.cross(axes[:, :5:2], axes[:, 2::2]), axis=2)  # of the angles of joints 2, 4 and 6
    for step in (0.1, 0.9):
        steps = step * np.array([9.0, 1.0, 9.0, 1.2, 9.0, 1.4, 9.0])
        near = sines <= np.sin(np.minimum(2.0 * steps[1:6:2], np.pi / 2))
        np.testing.assert_array_equal(found.crossing(3, steps), near @ [1, 2, 4])


def test_the_peaks_are_the_four_highest_local_maxima(robot):
    rng = np.random.default_rng(0)
    for trial in range(40):
        m, digits = (40, 3) if trial % 2 else (6, 1)  # rounding makes some neighbours equal
        mu, room = np.round(rng.uniform(0.1, 1.0, (1, 2, m)), digits), rng.uniform(-0.2, 0.7, (1, 2, m))
        found = pose_map.PoseMap(robot, None, np.arange(2.0 * m).reshape(1, 2, m, 1), mu, room)
        score = np.where(room[0] >= 0.0, mu[0], -np.inf).max(axis=0)
        tops = [j for j in range(m) if score[j - 1] <= score[j] >= score[(j + 1) % m] and np.isfinite(score[j])]
        highest = sorted(tops, key=lambda j: -score[j])[:4]
        poses = [[j + m * b] for b in (0, 1) for j in highest if room[0, b, j] >= 0.0]
        assert sorted(found.peaks(0).tolist()) == sorted(poses)


def test_the_eight_branches_of_a_map_contain_every_pose(arm):
    rng, branches = np.random.default_rng(1), set()
    for _ in range(40):
        q = arm.random_regular_pose(rng, margin=0.01)
        found = map_of(arm, q, at_poses(arm, np.array([q, q])), 8)  # the map samples the swivel of q itself
        gaps = np.abs(found.q_rad[0] - q)[..., :6].max(axis=-1)
        branch, j = (int(i) for i in np.unravel_index(int(gaps.argmin()), gaps.shape))
        assert gaps[branch, j] < 1e-9
        elbow = Elbow(arm, found.targets.wrist)
        assert found.closed.swivel_rad[j] == pytest.approx(elbow.swivel(q[None])[0], abs=1e-6)
        branches.add(branch)
    assert len(branches) == 8


def test_a_target_out_of_reach_has_no_pose(robot):
    q = robot.data.q_home
    targets = at_poses(robot, np.array([q, q]))
    away = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    found = map_of(robot, q, Targets(targets.t_s, targets.tip + away, targets.wrist + away, np.zeros(2)), 2880)
    assert np.isfinite(found.mu[0]).all()
    assert not any(each[1].any() for each in (np.isfinite(found.mu), np.isfinite(found.q_rad), found.feasible()))
    assert (found.peaks(0).shape[1], len(found.peaks(1))) == (7, 0)


@pytest.mark.parametrize("swivels", [4, 10**12, 9.5])
@pytest.mark.parametrize("name", ["lwr4", "panda"])
def test_too_few_and_too_many_swivels_are_refused(name, swivels):
    robot = load_robot(name)
    with pytest.raises(RobotError, match="swivels"):
        map_of(robot, robot.data.q_home, line_from(robot, robot.data.q_home), swivels)


@pytest.mark.parametrize("changes", [
    {"mount": (0.0, 0.0, -0.081), "rpy": (0.3, 0.0, 0.0)},  # a tool at an angle to axis 7
    {"wrist": (0.01, 0.0, -0.081), "mount": (0.01, 0.0, 0.045)},  # a tool parallel to axis 7, but not on this axis
    {"wrist": (0.0, 0.0, -0.07)},  # a wrist point that is not the intersection of axes 5 to 7
    {"q_max": np.radians([170, 120, 170, 120, 200, 120, 175])},  # a joint with a range above one turn
    {"joints": [*JOINTS[:2], ((0, 0, 0), (H, 0, np.pi)), ((0, 0, 0), (H, 0, 0)), *JOINTS[4:]]},  # no upper arm
    {"joints": [*JOINTS[:3], ((0.02, 0.0, 0.2155), (H, 0, 0)), *JOINTS[4:]]},  # elbow offset
    {"joints": [JOINTS[0], *(((0.02, y, z), (H, 0, np.pi)) for y, z in ((0, 0.2025), (0.2045, 0))), *JOINTS[3:]]},
    {"joints": [*JOINTS[:5], ((0.0, 0.0, 0.2155), (H - 0.1, 0, 0)), JOINTS[6]]},  # oblique axes
])  # fmt: skip
def test_an_arm_that_breaks_one_condition_has_no_closed_form(tmp_path, changes):
    assert closed_form(build(tmp_path, IIWA14)) is not None, "an iiwa14 with another name has a closed form too"
    whole_turn = np.radians([180, 120, 170, 120, 170, 120, 175])
    assert closed_form(build(tmp_path, IIWA14, q_max=whole_turn, q_min=-whole_turn)) is not None
    assert closed_form(build(tmp_path, IIWA14, **changes)) is None
    assert closed_form(load_robot("panda")) is None
    assert closed_form(sixteen_joints(tmp_path, np.zeros(16))) is None


def test_tracing_agrees_with_the_closed_form(robot, monkeypatch):
    targets = line_from(robot, robot.data.q_home)
    closed = map_of(robot, robot.data.q_home, targets)
    monkeypatch.setattr(pose_map, "closed_form", lambda robot: None)
    followed, again = (map_of(robot, robot.data.q_home, targets) for _ in range(2))
    tops = [np.where(each.feasible(), each.mu, 0.0).max(axis=(1, 2)) for each in (closed, followed)]
    np.testing.assert_allclose(*tops, atol=2e-4)
    assert followed.feasible().sum() > 200
    np.testing.assert_array_equal(followed.q_rad, again.q_rad)


def test_each_joint_keeps_its_own_margin(panda):
    robot, found = panda
    margin = np.array([0.4, 0.1, 0.8, 0.3, 0.05, 0.2, 9.0])  # the last joint is idle
    may, low, high = found.feasible(margin), robot.q_min + margin, robot.q_max - margin
    np.testing.assert_array_equal(may, ((found.q_rad >= low) & (found.q_rad <= high))[..., :6].all(axis=-1))
    assert found.feasible(0.8).sum() < may.sum() < found.feasible(0.05).sum()
    np.testing.assert_array_equal(found.feasible(np.full(7, 0.3)), found.feasible(0.3))
    np.testing.assert_array_equal(margin_of(load_robot("lwr4_rail"), 0.1, 0.2), [0.2, *7 * [0.1]])


def test_a_traced_map_has_every_pose_that_inverse_kinematics_finds(panda):
    robot, found = panda
    rng, seen = np.random.default_rng(5), 0
    for k in (0, 2):
        poses = found.q_rad[k, 0][np.isfinite(found.mu[k, 0])]
        for _ in range(40):
            start = rng.uniform(robot.q_min, robot.q_max)
            placed = solve_pose(robot, start, found.targets.tip[k], found.targets.wrist[k])
            if placed.found:
                seen += 1
                apart = np.abs(wrapped(poses - placed.q))[:, :6].max(axis=1)
                assert apart.min() < 0.1, "a pose that the map lacks"
    assert seen > 10


def test_a_traced_map_has_several_distinct_curves_for_each_target(panda):
    robot, line = panda
    tip, wrist, turn = line.targets.tip[0], line.targets.wrist[0], pin.exp3(np.array([0.0, 0.0, 0.05]))
    aside = tip + turn @ (wrist - tip)  # the tool rests, then turns about its tip, then about its wrist
    tips, wrists = np.array([tip, tip, tip, aside + turn @ (tip - aside)]), np.array([wrist, wrist, aside, aside])
    turning = map_of(robot, robot.data.q_home, Targets(line.targets.t_s, tips, wrists, np.zeros(4)))
    for found in (line, turning):
        assert found.mu.shape[:2] == (4, 1)
        for q, tip, wrist in zip(found.q_rad[:, 0], found.targets.tip, found.targets.wrist, strict=True):
            ends = np.array(robot.tool_along(q[np.isfinite(q[:, 0])]))
            np.testing.assert_allclose(ends - np.array([tip, wrist])[:, None], 0.0, atol=1e-8)
            pieces = np.split(q[:, :6], np.flatnonzero(np.isnan(q[:, 0])))
            curves = [curve for piece in pieces if len(curve := piece[np.isfinite(piece[:, 0])])]
            assert len(curves) > 1
            for one, two in itertools.permutations(curves, 2):
                assert np.linalg.norm(wrapped(np.diff(one, axis=0)), axis=1).max() < 1.11 * 0.03
                assert np.linalg.norm(wrapped(one - two[0]), axis=1).min() > 0.021, "the map has a curve twice"


def test_whole_turns_bring_joints_near_the_middle_of_their_range():
    for robot in (load_robot("panda"), load_robot("lwr4_rail")):
        q, slides = np.random.default_rng(0).uniform(-9.0, 9.0, (50, robot.n)), robot.chain.prismatic
        turns = (pose_map.nearest_turns(robot, q) - q) / (2.0 * np.pi)
        np.testing.assert_allclose(turns, np.where(slides, 0.0, np.round(turns)), atol=1e-12)
        assert np.abs(q + 2.0 * np.pi * turns - 0.5 * (robot.q_min + robot.q_max))[:, ~slides].max() < np.pi


def test_a_traced_map_is_denser_with_more_swivels(panda):
    robot, found = panda
    fewer, twice = (map_of(robot, robot.data.q_home, found.targets[:2], swivels) for swivels in (90, 1440))
    one, two, four = (np.isfinite(each.mu[0]).sum() for each in (fewer, found, twice))
    assert (one, four) == (two, pytest.approx(2 * two, rel=0.05))


def polished(robot, q, tip, wrist):
    free, pose = robot.moves.any(axis=0), q.copy()

    def state(x):
        pose[free] = x
        return robot.state(pose)

    # Five of the six equations suffice, because the tool is rigid.
    rows = np.linalg.svd(robot.state(q).A)[0][:, :5].T
    found = minimize(
        lambda x: (-state(x).mu, -state(x).grad_mu[free]), q[free], jac=True, method="SLSQP",
        bounds=np.transpose([robot.q_min, robot.q_max])[free], options={"maxiter": 200, "ftol": 1e-12}, constraints={
            "type": "eq", "fun": lambda x: rows @ np.concatenate([state(x).tip - tip, state(x).wrist - wrist]),
            "jac": lambda x: rows @ state(x).A[:, free],
        },
    )  # fmt: skip
    return state(found.x).q


def elsewhere(robot, q, starts, seed):
    s, rng = robot.state(q), np.random.default_rng(seed)
    placed = [solve_pose(robot, rng.uniform(robot.q_min, robot.q_max), s.tip, s.wrist) for _ in range(starts)]
    poses = sorted((p.q for p in placed if p.found), key=lambda pose: -robot.state(pose).mu)
    for pose in [polished(robot, pose, s.tip, s.wrist) for pose in poses[:8]]:
        there = robot.state(np.clip(pose, robot.q_min, robot.q_max))
        if max(np.abs(there.tip - s.tip).max(), np.abs(there.wrist - s.wrist).max()) < 1e-7:
            poses.append(there.q)
    return max(robot.state(pose).mu for pose in [*poses, q])


@pytest.mark.parametrize(("name", "method"), [
    ("lwr4", SCANNED), ("iiwa14", SCANNED),
    *((name, "best found of 96 starts") for name in ("panda", "gen3", "xarm7", "lwr4_rail")),
])  # fmt: skip
def test_inverse_kinematics_from_random_starts_finds_no_larger_mu(name, method):
    """For a single pose, `largest_mu` may be 1 % too small, because few of its starts reach the maximum."""
    robot, rng = load_robot(name), np.random.default_rng(21)
    poses = [robot.data.q_home, *rng.uniform(robot.q_min, robot.q_max, (2, robot.n))]
    found = [largest_mu(robot, q[None]) for q in poses]
    assert {each.method for each in found} == {method}
    gaps = [each.mu[0] / elsewhere(robot, q, 60, k) - 1.0 for k, (each, q) in enumerate(zip(found, poses, strict=True))]
    assert min(gaps) > -1e-2
    assert np.median(gaps) > -1e-6
    if method == SCANNED:
        np.testing.assert_allclose(largest_mu(robot, np.array(poses)).mu, [each.mu[0] for each in found], rtol=1e-6)


def test_each_point_of_a_path_reuses_the_maxima_of_its_neighbours(monkeypatch):
    robot = load_robot("xarm7")
    curve = np.linspace(0.0, 0.02, 8)[:, None] + robot.data.q_home
    monkeypatch.setattr(pose_map, "STARTS", 200)
    alone = np.array([largest_mu(robot, q[None]).mu[0] for q in curve])
    monkeypatch.setattr(pose_map, "STARTS", 2)
    monkeypatch.setattr(pose_map, "LATER", 8)
    found = largest_mu(robot, curve)
    assert found.method == f"best found of {2 + 7 * 8} starts"
    np.testing.assert_allclose(found.mu, alone, rtol=1e-6)


@pytest.mark.parametrize("name", ["panda", "lwr4_rail", "odd"])
def test_an_ascent_ends_at_a_maximum_within_the_limits(name, odd_robot):
    robot = odd_robot if name == "odd" else load_robot(name)
    rng, at_limits, found = np.random.default_rng(5), 0, 0
    for width in rng.choice([0.05, 0.3, 1.0, 9.0], 60):
        start = robot.random_regular_pose(rng)
        low, high = (start + side * rng.uniform(0.0, width, robot.n) for side in (-1, 1))
        low, high = np.clip([low, high], robot.q_min, robot.q_max)
        s, q, mu = robot.state(start), start[None].copy(), np.empty(1)
        target = np.array([s.tip, s.wrist])
        robot.arm.ascend(low, high, target, q, mu)
        there = robot.state(q[0])
        np.testing.assert_allclose([there.tip, there.wrist], target, atol=1e-9)
        assert np.all((low <= q[0]) & (q[0] <= high))
        assert pytest.approx(there.mu, rel=1e-12) == mu[0] >= s.mu - 1e-12
        ways = np.transpose([np.where(q[0] - low < 1e-6, 0.0, -1.0), np.where(high - q[0] < 1e-6, 0.0, 1.0)])
        across = np.linalg.svd(there.A)[2][:5]
        up = linprog(-there.grad_mu, A_eq=across, b_eq=np.zeros(5), bounds=ways).fun
        assert up > -1e-3 * np.abs(s.grad_mu).max()
        at_limits += bool((ways == 0.0)[robot.moves.any(axis=0)].any())
        goal = robot.state(np.clip(start + 0.2 * rng.normal(size=robot.n), low, high))
        found += robot.arm.nearest_pose(low, high, np.array([goal.tip, goal.wrist]), start, 60)[0] < 1e-9
        robot.arm.ascend(low, high, target + 10.0, q, mu)
        assert mu[0] == -1.0, "out of reach"
    assert at_limits > 20, "too few maxima are at a limit"
    assert found >= 58


@pytest.mark.parametrize("name", ["lwr4_rail", "odd"])
def test_one_curve_of_a_two_dimensional_self_motion_misses_the_largest_mu(name, odd_robot):
    robot, rng = odd_robot if name == "odd" else load_robot(name), np.random.default_rng(4)
    poses = [robot.data.q_home, *rng.uniform(0.7 * robot.q_min, 0.7 * robot.q_max, (3, robot.n))]
    shares = [self_motion(robot, q).mu_best / largest_mu(robot, q[None]).mu[0] for q in poses]
    assert min(shares) < 0.97
    assert max(shares) < 1.0 + 1e-6


def test_inverse_kinematics_approaches_a_target_out_of_reach(robot):
    free, rng, shoulder = without_limits(robot), np.random.default_rng(2), np.array([0.0, 0.0, 0.31])
    there = robot.state(beyond := robot.q_max + 0.1)
    np.testing.assert_allclose(pose_map.reach(robot, beyond - 0.01, there.tip, there.wrist)[:6], beyond[:6], atol=0.03)
    length = np.linalg.norm(free.state(np.zeros(7)).tip - shoulder)
    for direction in rng.normal(size=(8, 3)):
        way = direction / np.linalg.norm(direction)
        start = robot.data.q_home + rng.normal(scale=0.3, size=7)
        miss, _ = free.arm.nearest_pose(free.q_min, free.q_max, (shoulder + 2.0 * way)[None], start, 60)
        assert miss < (2.0 - length) * np.abs(way).max() + 1e-3
