"""Nothing moves from a start, or along a path, that the arm cannot do; what is let through it can."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import RobotError, ScenarioError, TaskError
from moc_opt.procedure import preflight
from moc_opt.procedure.preflight import check_start, random_start
from moc_opt.procedure.reachability import UnreachableError
from moc_opt.scenario import Scenario, Setup, run

PATHS = ("circle", "sinusoid", "spiral")


def setup(seed=0, path="circle", **tables):
    return Setup(Scenario(seed=seed, **{"start": {"pose": "random"}, "task": {"path": path}, **tables}))


# --- the start ---


def test_a_stretched_arm_is_refused_with_a_cure(robot):
    with pytest.raises(ScenarioError, match=r"\[start\] q_rad = .*singular.*home pose.*pose = 'random'"):
        check_start(robot, np.zeros(robot.n))


def test_a_tool_that_cannot_be_turned_is_singular_even_where_the_tip_moves_freely(robot):
    """Straight elbow: the tip moves in every direction, but tip and wrist have one freedom less together."""
    q = np.array([0.3, 0.6, -0.2, 0.0, 0.4, -0.9, 0.0])
    state = robot.state(q)
    assert state.mu > 0.1
    assert np.linalg.matrix_rank(state.A, tol=1e-9) == 4
    with pytest.raises(ScenarioError, match="the tool cannot be turned in every direction"):
        check_start(robot, q)


@pytest.mark.parametrize("bad", [[0.1] * 6, [0.1] * 6 + [np.nan], [[0.1] * 7]])
def test_a_start_of_another_shape_or_no_numbers(robot, bad):
    with pytest.raises(ScenarioError, match=r"\[start\] q_rad = .*give 7 finite numbers"):
        check_start(robot, bad)


@pytest.mark.parametrize("joint", range(7))
def test_a_joint_outside_its_limits_is_named(robot, joint):
    q = np.array(robot.data.q_home)
    q[joint] = robot.q_max[joint] + 1e-3
    with pytest.raises(ScenarioError, match=rf"joint {joint + 1} = .*choose"):
        check_start(robot, q)
    q[joint] = robot.q_max[joint]
    check_start(robot, q)  # at the limit is inside


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_regular_pose_may_begin(robot, seed):
    q = robot.random_regular_pose(np.random.default_rng(seed))
    if np.linalg.svd(robot.state(q).A, compute_uv=False)[4] > 1e-3:
        assert check_start(robot, q).mu > 0.05


# --- the path ---


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"task": {"sizes": {"radius": 3.0}}}, r"trocar: at .* more than the tool's 300 mm: make the path smaller"),
        (
            {"task": {"sizes": {"radius": 0.1}}, "trocar": {"depth_m": 0.02}},
            r"\[task\] joint limits: at .* mm along the path no pose has the tip.*smaller.*check_path = false",
        ),
    ],
)
def test_a_circle_out_of_reach_is_found_before_anything_moves(tables, message):
    moved = []
    with pytest.raises(UnreachableError, match=message):
        run(Scenario(**tables), watch=moved.append)
    assert moved == []


def test_a_path_too_fast_for_a_joint_names_a_speed():
    with pytest.raises(UnreachableError, match=r"v_max: .*lower v_max"):
        Setup(Scenario(task={"v_max_m_per_s": 5.0, "a_max_m_per_s2": 200.0}))


def test_the_check_of_the_path_can_be_switched_off_and_looks_no_farther_than_the_run():
    far = {"sizes": {"radius": 3.0}}
    assert Setup(Scenario(task=far, start={"check_path": False})).duration_s > 100.0
    assert Setup(Scenario(task=far, duration_s=0.6)).duration_s == 0.6


@pytest.mark.parametrize("path", [*PATHS, "line"])
def test_the_tasks_from_the_home_pose_are_let_through(path):
    Setup(Scenario(task={"path": path}))


def test_what_is_followed_is_the_registered_trocar(monkeypatch):
    """The check must not know the registration's error, which nobody knows before the operation."""
    seen = []

    def remember(robot, q, reference, trocar, **rest):
        seen.append(trocar)
        raise UnreachableError("path", 0.0, "looked at", "nothing")

    monkeypatch.setattr(preflight, "check_reachable", remember)
    with pytest.raises(UnreachableError, match="looked at"):
        Setup(Scenario())
    state = Scenario().robot.arm().state(Scenario().robot.arm().data.q_home)
    np.testing.assert_allclose(seen[0].at(0.0)[0], state.tip - 0.15 * state.tool_direction, atol=1e-12)


# --- random starts ---


@pytest.mark.parametrize("swivel", ["given", "random", 0.5])
@pytest.mark.parametrize("seed", range(4))
def test_a_random_start_keeps_the_stated_rules(robot, seed, swivel):
    made = setup(seed, PATHS[seed % 3], start={"pose": "random", "swivel": swivel})
    state = robot.state(made.q_start)
    tip, both = (np.linalg.svd(matrix, compute_uv=False) for matrix in (state.J_tip, state.A))
    assert tip[2] / tip[0] >= 0.1
    assert both[4] / both[0] >= 0.05
    assert (made.q_start - robot.q_min).min() >= 0.05
    assert (robot.q_max - made.q_start).min() >= 0.05
    assert min(state.tip[2], state.wrist[2]) >= 0.0
    np.testing.assert_allclose(made.reference.at(0.0)[0], state.tip, atol=1e-9)
    trocar = made.registered.at(0.0)[0]
    assert np.linalg.norm(trocar - state.tip) == pytest.approx(0.15)
    assert np.linalg.norm(np.cross(trocar - state.tip, state.tool_direction)) < 1e-9


@pytest.mark.parametrize(("name", "margins"), [("lwr4", (0.15, 0.0)), ("lwr4_rail", (0.05, 0.2))])
def test_a_random_start_keeps_the_margins_that_were_asked_for(name, margins):
    """Of each joint in its own unit, at the start and along the path."""
    keys = {"limit_margin_rad": margins[0], "limit_margin_m": margins[1]}
    made = setup(0, robot={"name": name}, start={"pose": "random", "swivel": "random", **keys})
    arm = made.robot
    asked = np.where(arm.chain.prismatic, margins[1], margins[0])
    reach = preflight.check_path(arm, made.q_start, made.reference, made.registered)
    for q in (made.q_start, *reach.q_rad):
        assert (np.minimum(q - arm.q_min, arm.q_max - q) >= asked).all()
    usual = setup(0, robot={"name": name}, start={"pose": "random", "swivel": "random"})
    room = np.minimum(usual.q_start - arm.q_min, arm.q_max - usual.q_start)
    reach = preflight.check_path(arm, usual.q_start, usual.reference, usual.registered)
    room = np.min([room, *(np.minimum(q - arm.q_min, arm.q_max - q) for q in reach.q_rad)], axis=0)
    assert (room < asked).any()  # the margins decide


def test_random_starts_repeat_and_differ_with_the_seed():
    poses = [setup(seed).q_start for seed in range(5)]
    np.testing.assert_array_equal(poses[3], setup(3).q_start)
    gaps = [np.abs(a - b).max() for i, a in enumerate(poses) for b in poses[:i]]
    assert min(gaps) > 0.05


def test_the_random_start_leaves_the_other_draws_as_they_are():
    """Plant, noise and swivel of a seed are those of before, so that results with the home pose stand."""
    home, drawn = setup(11, start={"pose": "home", "swivel": "random"}), setup(11)
    np.testing.assert_array_equal(home.plant.mismatch.registration_error, drawn.plant.mismatch.registration_error)
    assert dict(home.plant.mismatch.mass_scale) == dict(drawn.plant.mismatch.mass_scale)
    assert home._fault_seed == drawn._fault_seed
    # as it was before there were random poses
    start_seed = np.random.SeedSequence(11).generate_state(3)[0]
    fraction = np.random.default_rng(start_seed).uniform(0.05, 0.95)
    np.testing.assert_array_equal(home.q_start, Setup(Scenario(seed=11, start={"swivel": fraction})).q_start)


def test_the_random_start_is_that_of_the_whole_task_however_short_the_run():
    np.testing.assert_array_equal(setup(5).q_start, setup(5, duration_s=0.1).q_start)


def test_from_a_random_start_the_tool_follows_its_path():
    trace = run(Scenario(seed=6, start={"pose": "random"}, judge=False, bound_samples=0))
    assert trace.meta["ended"] == "completed"
    assert trace.tip_error_m.max() < 3e-3


def test_a_task_that_no_pose_can_do_says_what_stood_in_the_way(monkeypatch):
    monkeypatch.setattr(preflight, "DRAWS", 12)
    with pytest.raises(
        ScenarioError, match=r"none of 12 poses can do the task; rejected: .*the task is out of reach \(.*\) \d+.*make"
    ):
        setup(task={"sizes": {"radius": 2.0}})


def test_the_counts_of_rejections_add_up(robot, monkeypatch):
    monkeypatch.setattr(preflight, "DRAWS", 25)

    def never(q):
        raise UnreachableError("path", 0.0, "too far", "closer")

    def singular(q):
        raise RobotError("singular")

    for swivelled in (np.asarray, singular):
        with pytest.raises(ScenarioError) as told:
            random_start(robot, np.random.default_rng(0), swivelled, never, np.full(robot.n, 0.05))
        counts = str(told.value).partition("rejected: ")[2].partition(";")[0].split(", ")
        assert sum(int(entry.split()[-1]) for entry in counts) == 25


def test_what_is_wrong_from_every_pose_is_said_at_once():
    with pytest.raises(ScenarioError, match=r"depth_m = 0\.5"):
        setup(trocar={"depth_m": 0.5})
    with pytest.raises(TaskError, match="radius"):
        setup(task={"sizes": {"radius": -1.0}})


def test_a_given_pose_is_not_random():
    with pytest.raises(ScenarioError, match=r"\[start\].*pose = 'random' and q_rad exclude each other"):
        Scenario(start={"pose": "random", "q_rad": [0.1] * 7})
