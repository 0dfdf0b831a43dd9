"""Nothing moves from a start, or along a path, that the arm cannot do, and what is told names field, place and cure."""

import dataclasses
import re

import numpy as np
import pytest

from moc_opt.errors import ScenarioError
from moc_opt.planning.self_motion import freedoms, self_motion
from moc_opt.robots.inverse_kinematics import pose_through
from moc_opt.robots.model import RobotModel
from moc_opt.scenario import Scenario, Setup
from moc_opt.tasks import Reference, Trocar, make_path, shaft_distance
from moc_opt.vision import preflight
from moc_opt.vision.board import BOARD_TASKS, Board, board_below
from moc_opt.vision.preflight import UnreachableError, check_reachable, check_start

PATHS = ("circle", "sinusoid", "spiral")


def straight(start, end):
    way = end - start
    path = make_path("line", start, normal=np.cross(way, [1.0, 0.3, 0.2]), heading=way, length=np.linalg.norm(way))
    return Reference(path, 0.05, 0.2)


def setup(seed=0, path="circle", **tables):
    return Setup(Scenario(seed=seed, **{"start": {"pose": "random"}, "task": {"path": path}, **tables}))


@pytest.mark.parametrize(("q", "told"), [
    (np.zeros(7), "singular"),
    # The tip moves in every direction, but with the elbow straight tip and wrist have one freedom less together.
    ([0.3, 0.6, -0.2, 0.0, 0.4, -0.9, 0.0], "the tool cannot be turned in every direction"),
    ([0.1] * 6, "give 7 finite numbers"), ([0.1] * 6 + [np.nan], "give 7 finite numbers"),
])  # fmt: skip
def test_a_start_that_is_singular_or_no_pose_is_refused(robot, q, told):
    with pytest.raises(ScenarioError, match=told):
        check_start(robot, q)


def test_a_joint_outside_its_limits_is_named(robot):
    q, joint = np.array(robot.data.q_home), 4
    q[joint] = robot.q_max[joint] + 1e-3
    with pytest.raises(ScenarioError, match=rf"joint {joint + 1} = .*choose"):
        check_start(robot, q)
    q[joint] = robot.q_max[joint]
    check_start(robot, q)  # at the limit is inside


@pytest.fixture(scope="module")
def home(robot):
    return robot.state(robot.data.q_home)


@pytest.fixture(scope="module")
def trocar(home):
    return Trocar(home.tip - 0.15 * home.tool_direction)


PLACE_M = 0.006  #: The points that are looked at are 5 mm apart.


def reference(home, kind="circle", v_max=0.05, a_max=0.2, **sizes):
    return Reference(make_path(kind, home.tip, normal=(0, 0, 1), heading=(1, 0, 0), **sizes), v_max, a_max)


def check_followed(robot, found, task, trocar):
    """Tip and shaft are where they should be at every point of a way through the task."""
    tips, wrists = robot.tool_along(found)
    t = preflight._places(task, trocar, np.inf).t
    np.testing.assert_allclose(tips, task.at(t)[0], atol=2e-6)
    assert shaft_distance(tips, wrists, trocar.at(t)[0]).max() < 2e-6
    rates = np.diff(found, axis=0) / np.diff(t)[:, None]
    assert np.abs(rates / robot.v_max).max() < 1.0


@pytest.mark.parametrize("name", list(BOARD_TASKS))
def test_the_three_tasks_are_within_reach(robot, home, trocar, name):
    point = trocar.at(0.0)[0]
    board_in_base = board_below(point, home.tool_direction, BOARD_TASKS[name].depth_m)
    task = Reference(Board().task_in_base(BOARD_TASKS[name], board_in_base), 0.05, 0.2)
    q = pose_through(robot, task.path.start, point)
    found = check_reachable(robot, q, task, trocar)
    check_followed(robot, found, task, trocar)
    np.testing.assert_array_equal(found[0], robot.state(q).q)
    assert ((found > robot.q_min) & (found < robot.q_max)).all()


def test_too_fast_names_the_joint_and_a_speed_that_works(robot, home, trocar):
    with pytest.raises(UnreachableError) as told:
        check_reachable(robot, robot.data.q_home, reference(home, "line", 5.0, 200.0, length=0.06), trocar)
    assert told.value.field == "v_max"
    assert 0.0 < told.value.arc_length_m < 0.06
    slower = float(re.search(r"from 5 to ([0-9.]+) m/s", str(told.value)).group(1))
    assert 0.1 < slower < 5.0
    check_reachable(robot, robot.data.q_home, reference(home, "line", slower, 200.0, length=0.06), trocar)


def test_a_path_that_leaves_the_workspace_says_where(robot):
    """Drawn out along the shaft, the wrist rises until the arm is stretched."""
    tip, trocar = np.array([0.74, 0.0, 0.10]), np.array([0.74, 0.0, 0.30])
    upwards = straight(tip, tip + np.array([0.0, 0.0, 0.16]))
    with pytest.raises(UnreachableError) as told:
        check_reachable(robot, pose_through(robot, tip, trocar), upwards, Trocar(trocar))
    assert told.value.field == "path"
    # The shoulder is at 0.3105 m, the arm 0.79 m long, and the wrist 0.378 m above the tip.
    stretched = np.sqrt(0.79**2 - 0.74**2) + 0.3105 - 0.378 - 0.10
    assert told.value.arc_length_m == pytest.approx(stretched, abs=PLACE_M)
    assert f"{1e3 * told.value.arc_length_m:.1f} mm along the path" in str(told.value)


def test_joint_limits_are_named(robot, home, trocar):
    """The elbow's angle follows from the wrist's distance alone: no self-motion can help a joint 4 that is stuck."""
    highest = np.array(robot.q_max)
    highest[3] = home.q[3] + 0.05
    stiff = RobotModel(dataclasses.replace(robot.data, q_max=highest))
    with pytest.raises(UnreachableError, match="joint_4 at the limit") as told:
        check_reachable(stiff, home.q, reference(home, "line", length=0.1), trocar)
    assert told.value.field == "joint limits"
    free = check_reachable(robot, home.q, reference(home, "line", length=0.1), trocar)
    over = free[:, 3] > highest[3]
    assert told.value.arc_length_m == pytest.approx(0.1 * np.linspace(0.0, 1.0, len(free))[over][0], abs=PLACE_M)


def test_a_trocar_beyond_the_tool_or_on_the_path_and_a_start_elsewhere_are_refused(robot, home, trocar):
    up = straight(home.tip, home.tip + np.array([0.0, 0.0, 0.06]))
    away = straight(home.tip + np.array([0.0, 0.01, 0.0]), home.tip)
    for task, through, field, place in (
        (reference(home, radius=0.03), Trocar(trocar.at(0.0)[0] + np.array([0.0, 0.0, 0.3])), "trocar", 0.0),
        (up, Trocar(home.tip - 0.03 * home.tool_direction), "path", 0.03), (away, trocar, "start", 0.0),
    ):  # fmt: skip
        with pytest.raises(UnreachableError) as told:
            check_reachable(robot, home.q, task, through)
        assert told.value.field == field
        assert told.value.arc_length_m == pytest.approx(place, abs=PLACE_M)


def test_another_swivel_is_tried_where_the_given_one_gets_stuck(robot, home, trocar, monkeypatch):
    """A start that is made to fail is replaced by the one in the middle of its self-motion."""
    task, scan, solve = reference(home, radius=0.03), self_motion(robot, home.q), preflight.solve_pose

    def only_elsewhere(arm, q, tip, wrist):
        placed = solve(arm, q, tip, wrist)
        return placed if abs(q[0] - home.q[0]) > 0.05 else placed._replace(miss_m=1.0)

    monkeypatch.setattr(preflight, "solve_pose", only_elsewhere)
    found = check_reachable(robot, home.q, task, trocar)
    room = np.minimum(scan.q - robot.q_min, robot.q_max - scan.q).min(axis=1)
    taken = np.minimum(found[0] - robot.q_min, robot.q_max - found[0]).min()
    assert taken == pytest.approx(room.max(), abs=1e-6)


def test_breathing_trocars_are_followed(robot, home, trocar):
    circle, breathing = reference(home, radius=0.02), Trocar(trocar.at(0.0)[0], breathing_amplitude_m=0.01)
    check_followed(robot, check_reachable(robot, home.q, circle, breathing), circle, breathing)


@pytest.mark.parametrize(("seed", "swivel"), [(0, "given"), (1, "random"), (2, 0.5)])
def test_a_random_start_keeps_the_stated_rules(robot, seed, swivel):
    made = setup(seed, PATHS[seed % 3], start={"pose": "random", "swivel": swivel})
    state, left = robot.state(made.q_start), freedoms(robot, made.q_start)
    assert left.tip >= 0.1
    assert left.both >= 0.05
    assert np.minimum(made.q_start - robot.q_min, robot.q_max - made.q_start).min() >= 0.05
    assert min(state.tip[2], state.wrist[2]) >= 0.0
    np.testing.assert_allclose(made.reference.at(0.0)[0], state.tip, atol=1e-9)
    np.testing.assert_allclose(made.registered.at(0.0)[0], state.tip - 0.15 * state.tool_direction, atol=1e-9)


@pytest.mark.parametrize(("name", "margins"), [("lwr4", (0.15, 0.0)), ("lwr4_rail", (0.05, 0.2))])
def test_a_random_start_keeps_the_margins_that_were_asked_for(name, margins):
    """Of each joint in its own unit, at the start and along the path; without them there is less room."""
    asking = {"limit_margin_rad": margins[0], "limit_margin_m": margins[1]}
    kept = []
    for keys in (asking, {}):
        made = setup(0, robot={"name": name}, start={"pose": "random", "swivel": "random", **keys})
        arm, followed = made.robot, preflight.check_path(made.robot, made.q_start, made.reference, made.registered)
        poses = np.vstack([made.q_start, followed])
        asked = np.where(arm.chain.prismatic, margins[1], margins[0])
        kept.append(bool((np.minimum(poses - arm.q_min, arm.q_max - poses) >= asked).all()))
    assert kept == [True, False]
