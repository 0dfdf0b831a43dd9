"""The map over time and swivel has the model's mu. `read_trajectory` is tested on synthetic maps."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import ReportError, RobotError
from moc_opt.planning import swivel_map
from moc_opt.planning.elbow import Elbow, wrapped
from moc_opt.planning.pose_map import largest_mu
from moc_opt.planning.self_motion import self_motion
from moc_opt.planning.swivel_map import FEASIBLE, UNREACHABLE, End, manipulability_map
from moc_opt.report.map_page import map_figure
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.scenario import Scenario
from moc_opt.trace.trace import Trace


@pytest.fixture(scope="module")
def runs():
    moc = Scenario(plant={"preset": "nominal"}, start={"swivel": 0.2}, judge=False, bound_samples=0,
                   task={"wait_s": 0.5, "hold_s": 0.0, "v_max_m_per_s": 0.05, "a_max_m_per_s2": 0.2})  # fmt: skip
    return {"MOC": mo.run(moc), "DCAC": mo.run(moc.change(control={"law": "dcac"}))}


@pytest.fixture(scope="module")
def found(robot, runs):
    return manipulability_map(robot, runs, times=13, swivels=72)


def test_the_grid_equals_direct_evaluation(robot, runs, found):
    guide = max(runs.values(), key=len)
    ticks = np.searchsorted(guide.t_s, found.t_s)
    known = np.isfinite(found.q_rad).all(axis=2)
    assert known.mean() > 0.95, "this arm can turn its elbow all the way round"
    for k, tick in enumerate(ticks):
        tip = guide.tip_ref_m[tick]
        shaft = guide.trocar_registered_m[tick] - tip
        wrist = tip + shaft / np.linalg.norm(shaft) * robot.state(robot.data.q_home).tool_span
        q = found.q_rad[k, known[k]]
        np.testing.assert_array_equal(robot.mu_along(q), found.mu[k, known[k]])
        for places, place in zip(robot.tool_along(q), (tip, wrist), strict=True):
            np.testing.assert_allclose(places - place, 0.0, atol=1e-8)
        beyond = np.maximum(q - robot.q_max, robot.q_min - q)
        limit = np.where(beyond.max(axis=1) > 1e-9, 1 + beyond.argmax(axis=1), FEASIBLE)
        np.testing.assert_array_equal(found.limit[k, known[k]], limit)
    np.testing.assert_array_equal(found.limit == UNREACHABLE, ~known)
    assert 0.2 < (found.limit == FEASIBLE).mean() < 0.9
    angles = Elbow(robot, np.array([robot.state(found.q_rad[4, 0]).wrist])).swivel(found.q_rad[4])
    assert np.abs(np.mod(angles - found.swivel_rad + np.pi, 2 * np.pi) - np.pi).max() < 1e-6
    np.testing.assert_allclose(np.diff(found.swivel_rad), 2 * np.pi / 72)
    assert abs(found.swivel_rad.mean()) <= np.pi


def test_a_mirrored_pose_has_the_opposite_swivel(robot):
    q = np.array(robot.data.q_home)
    elbow = Elbow(robot, robot.state(q).wrist[None])
    assert elbow.joint == 3
    turned = q + np.eye(robot.n)[0]
    mirrored = q * np.array([-1, 1, -1, 1, -1, 1, -1])
    first, same, other = elbow.swivel(np.array([q, turned, mirrored]))
    assert (same, other) == (pytest.approx(first, abs=1e-12), pytest.approx(-first, abs=1e-12))
    assert abs(first) > 0.1
    np.testing.assert_allclose(wrapped(np.pi * np.array([0.9, 1.0, -1.0, 2.5])), np.pi * np.array([0.9, -1, -1, 0.5]))


def test_swivel_reference_is_not_nearly_parallel_to_the_line_to_the_wrist(robot):
    away = np.array([[0.01, 0.0, 0.5], [0.3, 0.0, 0.2]])  # from the shoulder to the wrist
    for wrists, axis in ((away[1:], 2), (away, 1), (away[:, [1, 0, 2]], 0)):
        np.testing.assert_array_equal(Elbow(robot, np.array([0.0, 0.0, 0.31]) + wrists).reference, np.eye(3)[axis])


def test_trajectories_lie_on_the_map(robot, runs, found):
    assert np.all(found.best_mu >= np.where(found.limit == FEASIBLE, found.mu, -np.inf).max(axis=1))
    for name, trajectory in found.trajectories.items():
        assert trajectory.gap_rad < 0.15, "the run's pose is not that of the nearest row of the map"
        assert (len(trajectory.t_s), trajectory.t_s[-1]) == (swivel_map.TRAJECTORY_POINTS, runs[name].t_s[-1])
        np.testing.assert_array_equal(
            trajectory.mu, robot.mu_along(runs[name].q_rad)[np.searchsorted(runs[name].t_s, trajectory.t_s)]
        )
        for k, t in enumerate(found.t_s):
            i = int(np.argmin(np.abs(trajectory.t_s - t)))
            on_map = np.interp(trajectory.swivel_rad[i], found.swivel_rad, found.mu[k])
            assert trajectory.mu[i] == pytest.approx(on_map, abs=2e-3)
            assert trajectory.mu[i] <= found.best_mu[k] + 1e-3
    for k in (0, 6, 12):
        motion = self_motion(robot, runs["MOC"].q_rad[np.searchsorted(runs["MOC"].t_s, found.t_s[k])])
        assert found.best_mu[k] == pytest.approx(motion.mu_best, abs=1e-5)
        angle = Elbow(robot, robot.state(motion.best).wrist[None]).swivel(motion.best[None])[0]
        assert np.cos(found.best_swivel_rad[k] - angle) > np.cos(1e-3)


def test_a_run_on_another_branch_has_a_large_gap(robot, runs):
    flip = np.array(runs["MOC"].q_rad)
    flip[:, 4] -= np.pi * np.sign(flip[:, 4])
    flip[:, 5] *= -1.0
    flipped = runs["MOC"].with_columns(q_rad=flip).select(runs["MOC"].t_s < 7.0)  # the map follows the longest run
    both = manipulability_map(robot, {"MOC": runs["MOC"], "flipped": flipped}, times=3, swivels=24)
    assert both.trajectories["MOC"].gap_rad < 0.3 < 1.0 < both.trajectories["flipped"].gap_rad


def test_map_is_centred_on_the_allowed_poses(robot, runs, found):
    q = found.q_rad[6, np.argmin(np.cos(found.swivel_rad - 0.8))]
    narrow = RobotModel(replace(robot.data, q_min=q - 0.3, q_max=q + 0.3, q_home=q))
    made = manipulability_map(narrow, {"MOC": runs["MOC"]}, times=3, swivels=72)
    rows = np.flatnonzero((made.limit == FEASIBLE).any(axis=0))
    assert min(rows[0], 72 - rows[-1]) >= 33, "the allowed poses are in the middle of the map"
    assert abs(made.swivel_rad.mean()) <= np.pi


def test_targets_out_of_reach_are_marked_unreachable(robot, runs):
    moc = runs["MOC"]
    away = np.where(np.arange(len(moc)) < len(moc) // 2, 0.0, 1.0)[:, None] * np.eye(3)[0]
    torn = moc.with_columns(tip_ref_m=moc.tip_ref_m + away, trocar_registered_m=moc.trocar_registered_m + away)
    some = manipulability_map(robot, {"MOC": torn}, times=4, swivels=12)
    assert (some.limit[2:] == -1).all()
    np.testing.assert_array_equal(np.isnan(some.best_mu), [False, False, True, True])


def test_wrong_input_is_refused(robot, odd_robot, runs):
    moc = runs["MOC"]
    moved = moc.with_columns(tip_ref_m=moc.tip_ref_m + 1e-3 * (moc.t_s > 0.1)[:, None])
    wild = moc.with_columns(tip_m=np.where(np.arange(len(moc))[:, None] > 9, np.nan, moc.tip_m))
    bare = Trace({name: moc.columns[name] for name in ("t_s", "q_rad", "tip_m", "tip_ref_m")})
    for traces, words in (
        ({}, "0 runs"), ({"a": moc, "b": moved}, "'b' follows another path"), ({"x": bare}, "no column 'trocar_m'"),
        ({"x": Trace({"t_s": moc.t_s, "q_rad": moc.q_rad})}, "lacks the columns tip_m, tip_ref_m"),
        ({"x": moc.select(np.zeros(len(moc), dtype=bool))}, "has no ticks"), ({"x": wild}, "not finite in 'tip_m'"),
        ({"x": moc.with_columns(q_rad=moc.q_rad[:, :6])}, "has 6 joints"),
        ({"x": Trace(dict(moc.columns), {"kind": "course"})}, "is a course, not a run"),
    ):  # fmt: skip
        with pytest.raises(ReportError, match=words):
            manipulability_map(robot, traces)
    for times, swivels in ((1, 8), (2, 7)):
        with pytest.raises(ReportError, match=f"1 runs, {times} times, {swivels} swivels"):
            manipulability_map(robot, {"MOC": moc}, times=times, swivels=swivels)
    state = odd_robot.state(odd_robot.data.q_home)
    ticks = np.ones((4, 1))
    odd = Trace({
        "t_s": 0.002 * np.arange(4), "q_rad": ticks * state.q, "tip_m": ticks * state.tip,
        "tip_ref_m": ticks * state.tip, "trocar_m": ticks * 0.5 * (state.tip + state.wrist),
    })  # fmt: skip
    with pytest.raises(RobotError, match="does not tell the poses apart"):
        manipulability_map(odd_robot, {"odd": odd}, times=2, swivels=8)


def test_the_figure_shows_the_map_and_its_trajectories(found):
    drawn = map_figure(found)
    colored, grey = (trace for trace in drawn.data if trace.type == "heatmap")
    np.testing.assert_array_equal(np.isnan(grey.z.T), found.limit == FEASIBLE)
    np.testing.assert_allclose(colored.z.T, np.where(found.limit == UNREACHABLE, np.nan, found.mu), atol=1e-6)
    legend = [trace.name for trace in drawn.data if trace.type == "scatter" and trace.showlegend is None]
    assert legend == ["MOC", "DCAC", "best", "not allowed"]
    with pytest.raises(ReportError, match="within the joint limits"):
        map_figure(replace(found, limit=np.ones_like(found.limit)))


def test_map_keeps_the_rail_position_of_the_run(found):
    arm = load_robot("lwr4_rail")
    run_of_it = mo.run(Scenario(robot={"name": "lwr4_rail"}, duration_s=1.0, judge=False, bound_samples=0))
    made = manipulability_map(arm, {"MOC": run_of_it}, times=2, swivels=72)
    assert made.held == ("joint_1",)
    ticks = [0, len(run_of_it) - 1]
    for k, tick in enumerate(ticks):
        known = np.isfinite(made.q_rad[k, :, 0])
        np.testing.assert_allclose(made.q_rad[k, known, 0], run_of_it.q_rad[tick, 0], atol=1e-2)
    assert found.held == (), "the map of the lwr4 holds no joint"
    # The run starts at a poor position of the rail.
    assert made.best_mu[0] < 0.9 * largest_mu(arm, run_of_it.q_rad[:1]).mu[0]


T = np.linspace(0.0, 10.0, 21)
ROWS = np.arange(-180.0, 180.0, 3.0)


def hill(top, height, width=60.0):
    return lambda swivel: height * np.exp(-(((np.asarray(swivel) - top + 180) % 360 - 180) ** 2) / width**2)


def read(mu, swivel, forbidden=None, gap_rad=0.01, since=0.0):
    """``forbidden`` = (a, b, entry) sets `limit` to ``entry`` at swivels in [a, b] [deg], from ``since`` [s] on."""
    limit = np.full((len(T), len(ROWS)), FEASIBLE)
    if forbidden:
        limit[np.ix_(since <= T, (forbidden[0] <= ROWS) & (forbidden[1] >= ROWS))] = forbidden[2]
    grid = np.tile(mu(ROWS), (len(T), 1))
    feasible = np.where(limit == FEASIBLE, grid, -np.inf)
    best = feasible.max(axis=1)
    best[~np.isfinite(best)] = np.nan
    grid[limit == UNREACHABLE] = np.nan
    t = np.linspace(0.0, 10.0, 101)
    degrees = np.broadcast_to(np.asarray(swivel, dtype=float), t.shape)
    lines = MappingProxyType({"run": swivel_map.Trajectory(t, np.radians(degrees), mu(degrees), gap_rad)})
    peak = np.radians(ROWS[np.argmax(feasible, axis=1)])
    poses = np.zeros((len(T), len(ROWS), 7))
    made = swivel_map.SwivelMap(T, np.radians(ROWS), grid, poses, limit, peak, best, lines)
    return swivel_map.read_trajectory(made, "run")


def ramp(start, end, until=10.0):
    return start + (end - start) * np.minimum(np.linspace(0.0, 10.0, 101) / until, 1.0)


def test_a_run_that_climbs_to_the_optimum_ends_at_the_optimum():
    mu, swivels = hill(60.0, 0.3), ramp(-30.0, 60.0, until=5.0)
    found = read(mu, swivels)
    assert found.end is End.OPTIMUM
    near_from = 60.0 - 60.0 * np.sqrt(-np.log(1.0 - swivel_map.NEAR))  # swivel [deg] at which mu is 2 % below the top
    arrives = 5.0 * (near_from + 30.0) / 90.0
    assert (found.from_s, 10.0 - 10.0 * found.near) == pytest.approx((arrives, arrives), abs=0.11)
    assert (found.travel_rad, 0.3 * found.mu_share) == pytest.approx((np.radians(90.0), mu(swivels).mean()))
    always = read(mu, 60.0)
    assert (always.near, always.from_s) == (1.0, 0.0)
    assert read(mu, np.append(np.full(100, 60.0), 0.0)).from_s == 10.0, "the run leaves the optimum at the end"


def test_a_run_can_end_at_a_local_maximum():
    def two(swivel):
        return hill(60.0, 0.3, 30.0)(swivel) + hill(-60.0, 0.25, 30.0)(swivel)

    assert read(two, ramp(-100.0, -60.0, 6.0)).end is End.LOCAL_MAXIMUM
    assert read(two, -60.0 - 0.7 * np.degrees(swivel_map.CLOSE_RAD)).end is End.LOCAL_MAXIMUM
    assert read(two, -60.0 - 2.0 * np.degrees(swivel_map.CLOSE_RAD)).end is End.STILL, "the run could climb further"
    assert read(two, 60.0 - 0.7 * np.degrees(swivel_map.CLOSE_RAD)).end is End.STILL, "the maximum at 60 deg is global"
    # The shifted lower hill has its top at 178 degrees, and the run is at -176.
    assert read(lambda swivel: two(np.asarray(swivel) - 238.0), -176.0).end is End.LOCAL_MAXIMUM


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("mu", "swivel", "end"), [
    # Joint 4 is beyond its limit at swivels from 0 to 140 deg. Without this limit, mu would be largest at 60 deg.
    (hill(60.0, 0.3), -4.0, End.FEASIBLE_EDGE), (hill(60.0, 0.3), -16.0, End.FEASIBLE_EDGE),
    (hill(60.0, 0.3), -17.0, End.STILL), (hill(60.0, 0.3, 200.0), -4.0, End.OPTIMUM),
    (hill(60.0, 0.3, 90.0), ramp(-69.5, -60.0), End.STILL), (hill(60.0, 0.3, 90.0), ramp(-120.0, -30.0), End.RISING),
    (hill(60.0, 0.3, 90.0), ramp(-20.0, -70.0), End.FALLING), (hill(60.0, 0.3, 90.0), ramp(-70.5, -60.0), End.RISING),
])  # fmt: skip
def test_only_an_end_at_the_feasible_edge_names_a_joint(side, mu, swivel, end):
    forbidden = (0.0, 140.0, 4) if side > 0.0 else (-140.0, 0.0, 4)
    found = read(lambda given: mu(side * np.asarray(given)), side * np.asarray(swivel), forbidden)
    assert (found.end, found.joint) == (end, 4 if end is End.FEASIBLE_EDGE else 0)


def test_time_beside_forbidden_poses_is_counted():
    found = read(hill(60.0, 0.3), ramp(-20.0, 50.0), (10.0, 20.0, 4))  # forbidden: 12, 15, 18 deg; beside: 9, 21 deg
    assert found.at_edge == pytest.approx(np.mean(np.abs(ramp(-20.0, 50.0) - 15.0) < 7.5))
    late = read(hill(60.0, 0.3), 0.0, (-4.0, 20.0, 4), since=5.0)
    assert late.at_edge == pytest.approx(53 / 101), "from 4.75 s on, 5 s is the nearest time of the map"
    away = read(hill(60.0, 0.3), -40.0, (-4.0, 20.0, 4))
    assert away.at_edge == 0.0


def test_a_run_on_another_branch_is_not_compared():
    elsewhere = read(hill(60.0, 0.3), 60.0, gap_rad=0.55)
    assert elsewhere.end is End.OTHER_BRANCH
    assert np.isnan([elsewhere.near, elsewhere.mu_share, elsewhere.from_s]).all()
    nowhere = read(hill(60.0, 0.3), 60.0, (-180.0, 180.0, 1))
    assert nowhere.end is End.UNKNOWN


def test_an_angle_less_than_half_a_step_from_the_first_swivel_is_mapped_next_to_it():
    swivel = np.linspace(-2.0, 4.0, 61)
    near = swivel[0] + np.array([-0.04, 0.04])
    np.testing.assert_allclose(swivel_map._onto(near + 2.0 * np.pi, swivel), near)
