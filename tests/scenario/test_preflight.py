"""Impossible starts and paths are refused."""

import dataclasses
import re

import numpy as np
import pytest

from moc_opt.errors import ScenarioError
from moc_opt.planning.self_motion import freedoms, self_motion
from moc_opt.robots.inverse_kinematics import pose_through
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.scenario import Scenario, Setup, preflight
from moc_opt.scenario.preflight import UnreachableError, check_reachable, check_start
from moc_opt.tasks import Reference, Trocar, make_path, shaft_distance

PLACE_M = 0.006  #: Tolerance [m] of a place along the path. The checked points are 5 mm apart.
PATHS = ("circle", "sinusoid", "spiral")
ROBOT = load_robot()
HOME = ROBOT.state(ROBOT.data.q_home)
INCISION = HOME.tip - 0.15 * HOME.tool_direction
TROCAR = Trocar(INCISION)


def straight(start, end):
    way = end - start
    path = make_path("line", start, normal=np.cross(way, [1.0, 0.3, 0.2]), heading=way, length=np.linalg.norm(way))
    return Reference(path, 0.05, 0.2)


def setup(seed=0, path="circle", **tables):
    return Setup(Scenario(seed=seed, **{"start": {"pose": "random"}, "task": {"path": path}, **tables}))


@pytest.mark.parametrize(("q", "told"), [
    (np.zeros(7), "singular"),
    # With a straight elbow, the tool cannot turn in every direction.
    ([0.3, 0.6, -0.2, 0.0, 0.4, -0.9, 0.0], "the tool cannot be turned in every direction"),
    ([0.1] * 6, "give 7 finite numbers"), ([0.1] * 6 + [np.nan], "give 7 finite numbers"),
])  # fmt: skip
def test_singular_or_invalid_start_is_refused(q, told):
    with pytest.raises(ScenarioError, match=told):
        check_start(ROBOT, q)


def test_joint_outside_its_limits_is_named():
    q, joint = np.array(ROBOT.data.q_home), 4
    q[joint] = ROBOT.q_max[joint] + 1e-3
    with pytest.raises(ScenarioError, match=rf"joint {joint + 1} = .*choose"):
        check_start(ROBOT, q)
    q[joint] = ROBOT.q_max[joint]
    check_start(ROBOT, q)  # the limit is allowed


def reference(kind="circle", v_max=0.05, a_max=0.2, **sizes):
    return Reference(make_path(kind, HOME.tip, normal=(0, 0, 1), heading=(1, 0, 0), **sizes), v_max, a_max)


def test_error_for_too_fast_path_suggests_a_feasible_speed():
    with pytest.raises(UnreachableError) as told:
        check_reachable(ROBOT, ROBOT.data.q_home, reference("line", 5.0, 200.0, length=0.06), TROCAR)
    assert told.value.field == "v_max"
    assert 0.0 < told.value.arc_length_m < 0.06
    slower = float(re.search(r"from 5 to ([0-9.]+) m/s", str(told.value)).group(1))
    assert 0.1 < slower < 5.0
    check_reachable(ROBOT, ROBOT.data.q_home, reference("line", slower, 200.0, length=0.06), TROCAR)


def test_error_for_path_out_of_the_workspace_says_where():
    """The path pulls the tool out until the arm is stretched."""
    tip, trocar = np.array([0.74, 0.0, 0.10]), np.array([0.74, 0.0, 0.30])
    upwards = straight(tip, tip + np.array([0.0, 0.0, 0.16]))
    with pytest.raises(UnreachableError) as told:
        check_reachable(ROBOT, pose_through(ROBOT, tip, trocar), upwards, Trocar(trocar))
    assert told.value.field == "path"
    # The shoulder is at 0.3105 m, the arm 0.79 m long, and the wrist 0.378 m above the tip.
    stretched = np.sqrt(0.79**2 - 0.74**2) + 0.3105 - 0.378 - 0.10
    assert told.value.arc_length_m == pytest.approx(stretched, abs=PLACE_M)
    assert f"{1e3 * told.value.arc_length_m:.1f} mm along the path" in str(told.value)


def test_joint_that_reaches_its_limit_along_the_path_is_named():
    """Self-motion cannot avoid the limit, because it does not move joint 4 (the elbow)."""
    highest = np.array(ROBOT.q_max)
    highest[3] = HOME.q[3] + 0.05
    stiff = RobotModel(dataclasses.replace(ROBOT.data, q_max=highest))
    with pytest.raises(UnreachableError, match="joint_4 at the limit") as told:
        check_reachable(stiff, HOME.q, reference("line", length=0.1), TROCAR)
    assert told.value.field == "joint limits"
    free = check_reachable(ROBOT, HOME.q, reference("line", length=0.1), TROCAR)
    over = free[:, 3] > highest[3]
    assert told.value.arc_length_m == pytest.approx(0.1 * np.linspace(0.0, 1.0, len(free))[over][0], abs=PLACE_M)


def test_error_blames_the_trocar_the_path_or_the_start():
    up = straight(HOME.tip, HOME.tip + np.array([0.0, 0.0, 0.06]))
    away = straight(HOME.tip + np.array([0.0, 0.01, 0.0]), HOME.tip)
    for task, through, field, place in (
        (reference(radius=0.03), Trocar(INCISION + np.array([0.0, 0.0, 0.3])), "trocar", 0.0),
        (up, Trocar(HOME.tip - 0.03 * HOME.tool_direction), "path", 0.03), (away, TROCAR, "start", 0.0),
    ):  # fmt: skip
        with pytest.raises(UnreachableError) as told:
            check_reachable(ROBOT, HOME.q, task, through)
        assert (told.value.field, told.value.arc_length_m) == (field, pytest.approx(place, abs=PLACE_M))


def test_another_elbow_position_is_tried_if_the_first_fails(monkeypatch):
    """`solve_pose` is made to fail near the start's elbow position."""
    task, scan, solve = reference(radius=0.03), self_motion(ROBOT, HOME.q), preflight.solve_pose

    def only_elsewhere(arm, q, tip, wrist):
        placed = solve(arm, q, tip, wrist)
        return placed if abs(q[0] - HOME.q[0]) > 0.05 else placed._replace(miss_m=1.0)

    monkeypatch.setattr(preflight, "solve_pose", only_elsewhere)
    found = check_reachable(ROBOT, HOME.q, task, TROCAR)
    room = np.minimum(scan.q - ROBOT.q_min, ROBOT.q_max - scan.q).min(axis=1)
    taken = np.minimum(found[0] - ROBOT.q_min, ROBOT.q_max - found[0]).min()
    assert taken == pytest.approx(room.max(), abs=1e-6)


def test_shaft_follows_a_breathing_trocar():
    circle, breathing = reference(radius=0.02), Trocar(INCISION, breathing_amplitude_m=0.01)
    found = check_reachable(ROBOT, HOME.q, circle, breathing)
    tips, wrists = ROBOT.tool_along(found)
    t = preflight._places(circle, breathing, np.inf).t
    np.testing.assert_allclose(tips, circle.at(t)[0], atol=2e-6)
    assert shaft_distance(tips, wrists, breathing.at(t)[0]).max() < 2e-6
    rates = np.diff(found, axis=0) / np.diff(t)[:, None]
    assert np.abs(rates / ROBOT.v_max).max() < 1.0


@pytest.mark.parametrize(("seed", "swivel"), [(0, "given"), (1, "random"), (2, 0.5)])
def test_a_random_start_is_regular_and_away_from_joint_limits(seed, swivel):
    made = setup(seed, PATHS[seed % 3], start={"pose": "random", "swivel": swivel})
    state, left = ROBOT.state(made.q_start), freedoms(ROBOT, made.q_start)
    assert left.tip >= 0.1
    assert left.both >= 0.05
    assert np.minimum(made.q_start - ROBOT.q_min, ROBOT.q_max - made.q_start).min() >= 0.05
    assert min(state.tip[2], state.wrist[2]) >= 0.0
    np.testing.assert_allclose(made.reference.at(0.0)[0], state.tip, atol=1e-9)
    np.testing.assert_allclose(made.registered.at(0.0)[0], state.tip - 0.15 * state.tool_direction, atol=1e-9)


@pytest.mark.parametrize(("name", "margins"), [("lwr4", (0.15, 0.0)), ("lwr4_rail", (0.05, 0.2))])
def test_random_start_keeps_the_given_margins(name, margins):
    """If the scenario gives no margins, some joint comes nearer to its limit than `margins`."""
    asking = {"limit_margin_rad": margins[0], "limit_margin_m": margins[1]}
    for keys, kept in ((asking, True), ({}, False)):
        made = setup(0, robot={"name": name}, start={"pose": "random", "swivel": "random", **keys})
        arm = made.robot
        followed = preflight.check_reachable(arm, made.q_start, made.reference, made.registered)
        poses, asked = np.vstack([made.q_start, followed]), np.where(arm.chain.prismatic, margins[1], margins[0])
        assert (np.minimum(poses - arm.q_min, arm.q_max - poses) >= asked).all() == kept
