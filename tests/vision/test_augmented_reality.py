"""From the camera to the arm: the board located, the task carried over, and the tip held while it is lost."""

import cv2
import numpy as np
import pytest

from moc_opt.control import Controller, ControlSettings
from moc_opt.errors import TaskError
from moc_opt.model.inverse_kinematics import pose_through
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim import Plant, PlantSettings
from moc_opt.sim.loop import simulate
from moc_opt.tasks import Reference
from moc_opt.tasks.waiting import WaitingReference, flags_at
from moc_opt.vision.augmented_reality import Augmented
from moc_opt.vision.board import BOARD_TASKS, board_below
from moc_opt.vision.pose import Pose
from moc_opt.vision.settings import BoardSettings, CameraSettings

DRAWN = CameraSettings(source="drawn", rate_Hz=20.0, calibration_error_m=0.0, calibration_error_deg=0.0)
CIRCLE = BOARD_TASKS["circle"]


@pytest.fixture(scope="module")
def trocar(robot):
    home = robot.state(robot.data.q_home)
    return home.tip - 0.15 * home.tool_direction


@pytest.fixture(scope="module")
def phantom(robot, trocar):
    return board_below(
        trocar, robot.state(robot.data.q_home).tool_direction, CIRCLE.depth_m, x_axis=(1, 0.3, 0)
    )


def test_the_board_is_located_and_the_task_carried_over(robot, phantom):
    scene = Augmented(robot, phantom, camera=DRAWN, board=BoardSettings(hidden_fraction=0.3))
    found = scene.accuracy(scene.locate(robot.data.q_home), "circle")
    assert found["board_position_mm"] < 0.15
    assert found["board_angle_deg"] < 0.05
    assert found["task_error_max_mm"] < 0.15


def test_a_wrong_calibration_carries_over_to_the_task(robot, phantom):
    camera = CameraSettings(source="drawn", calibration_error_m=0.002, calibration_error_deg=0.0)
    scene = Augmented(robot, phantom, camera=camera)
    assert scene.accuracy(scene.locate(), CIRCLE)["task_error_max_mm"] == pytest.approx(2.0, abs=0.15)


def test_the_same_seed_gives_the_same_pose(robot, phantom):
    one, other = (Augmented(robot, phantom, camera=DRAWN, seed=5).locate(seconds=0.2) for _ in range(2))
    np.testing.assert_array_equal(one.R, other.R)
    np.testing.assert_array_equal(one.t, other.t)


@pytest.mark.parametrize(
    ("board", "reason"),
    [
        (BoardSettings(hidden_fraction=1.0), "no marker seen"),
        (BoardSettings(hidden_fraction=0.9), "2 markers seen, 3 needed"),
    ],
)
def test_a_board_that_is_never_seen_is_told_before_anything_moves(robot, phantom, board, reason):
    camera = CameraSettings(source="drawn", rate_Hz=5.0)
    with pytest.raises(TaskError, match=rf"board: never seen in 16 pictures: {reason} \(16 pictures\)"):
        Augmented(robot, phantom, camera=camera, board=board).locate()


def test_a_run_needs_a_located_board(robot, phantom):
    scene = Augmented(robot, phantom, camera=DRAWN, board=BoardSettings(lost_s=((0.0, 1.0),)))
    with pytest.raises(TaskError, match=r"locate\(\)"):
        scene.watch(0.5)


def test_a_loss_is_seen_and_a_moved_board_followed(robot, phantom):
    scene = Augmented(robot, phantom, camera=DRAWN, board=BoardSettings(lost_s=((0.5, 1.0),)))
    anchor = scene.locate(seconds=0.3)
    moved = Pose(phantom.R, phantom.t + np.array([0.01, 0.0, 0.0]))
    watch = scene.watch(2.0, board_in_base=lambda t: phantom if t < 0.7 else moved)
    lost = watch.t_s[~watch.seen]
    assert 0.5 < lost[0] < 0.75
    assert 1.0 < lost[-1] + 0.05 < 1.2
    shifts = np.array([(board @ anchor.inverse()).apply(phantom.t) - phantom.t for board in watch.boards])
    assert np.abs(shifts[watch.t_s < 1.0]).max() < 2e-4
    np.testing.assert_allclose(shifts[-1], [0.01, 0.0, 0.0], atol=2e-4)


@pytest.fixture(scope="module")
def run(robot, phantom, trocar):
    """The whole loop, the board lost for a second in the middle of the circle."""
    scene = Augmented(
        robot, phantom, camera=DRAWN, board=BoardSettings(hidden_fraction=0.2, lost_s=((2.0, 3.0),))
    )
    path = scene.task(CIRCLE, scene.locate(seconds=0.3))
    q = pose_through(robot, path.start, trocar)
    seconds, period = 6.5, 0.002
    watch = scene.watch(seconds, lambda t: q)
    times = period * np.arange(round(seconds / period))
    waiting = WaitingReference(Reference(path, 0.05, 0.2), period)
    rows, played = waiting.play(flags_at(times, watch.t_s, watch.seen))
    plant = Plant(robot.data, PlantSettings.realistic(trocar_registration_error_m=0.0), seed=1)
    plant.reset(q)
    points = np.tile(np.stack([trocar, np.zeros(3)]), (len(times), 1, 1))
    driver = ControllerAdapter(Controller(robot, ControlSettings(law="dcac"), None, period))
    trace = simulate(plant, driver, rows, points, points)
    return scene, path, trace, played, waiting


def test_the_task_waits_the_tip_holds_and_nothing_jumps(run):
    _, _, trace, played, waiting = run
    holding = (trace.t_s > 2.0 + 0.2 + waiting.settle_s + 0.1) & (trace.t_s < 3.0)
    assert np.ptp(played[holding]) == 0.0
    assert np.ptp(trace.tip_m[holding], axis=0).max() < 2e-4
    speed = np.linalg.norm(np.diff(trace.tip_m, axis=0), axis=1) / 0.002
    assert speed.max() < 1.3 * waiting.reference.v_max
    assert trace.tip_error_m[100:].max() < 1.5e-3
    assert played[-1] > played[holding][0] + 1.0


def test_the_film_shows_the_run(run, tmp_path, trocar):
    scene, path, trace, _, _ = run
    short = trace.select(np.arange(len(trace)) < 500)
    count = scene.film(tmp_path / "run", short, path, trocar)
    assert count == 20
    pictures = [cv2.imread(str(name)) for name in sorted((tmp_path / "run").iterdir())]
    assert len(pictures) == count
    assert pictures[0].shape == (480, 640, 3)
    assert (pictures[0] != pictures[-1]).any()
