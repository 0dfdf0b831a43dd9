"""MuJoCo's picture and the drawn one are of the same scene; tests that need GL skip where there is none."""

import ctypes.util

import numpy as np
import pytest

from moc_opt.errors import PlantError
from moc_opt.model.robot_model import load_robot
from moc_opt.robots import load_data
from moc_opt.vision.board import Board, board_below
from moc_opt.vision.camera import Camera, Scene
from moc_opt.vision.markers import BoardFinder
from moc_opt.vision.pinhole import DrawnView
from moc_opt.vision.render import RenderedView, gl_platform
from moc_opt.vision.settings import CameraSettings

DATA = load_data("lwr4")
ROBOT = load_robot("lwr4")
HOME = ROBOT.state(DATA.q_home)
BOARD = Board()
PHANTOM = board_below(HOME.tip - 0.15 * HOME.tool_direction, HOME.tool_direction, 0.155)
SETTINGS = CameraSettings(noise=0.0, blur_px=0.0)
CAMERA = Camera.above(SETTINGS, PHANTOM)


def shaft(q):
    state = ROBOT.state(q)
    return state.tip, state.wrist


@pytest.fixture(scope="module")
def rendered():
    try:
        view = RenderedView(DATA, CAMERA, BOARD)
    except PlantError as error:
        pytest.skip(f"no off-screen rendering here: {error}")
    yield view
    view.close()


SCENES = {
    "board": Scene(PHANTOM),
    "tool": Scene(PHANTOM, q=np.array(DATA.q_home)),
    "covers": Scene(PHANTOM, frozenset({0, 6, 19})),
    "dark": Scene(PHANTOM, dark=True),
}


@pytest.mark.parametrize("name", list(SCENES))
def test_it_shows_what_the_pinhole_draws(rendered, name):
    one, other = (
        view.picture(SCENES[name]).astype(int) for view in (rendered, DrawnView(CAMERA, BOARD, shaft=shaft))
    )
    off = np.abs(one - other).max(axis=2)
    # Edges are drawn a little differently, and the tool's tip is round here and square there.
    assert (off > 60).mean() < 0.006
    assert np.median(off) <= 2


def test_both_pictures_give_the_same_pose(rendered):
    finder, truth = BoardFinder(BOARD, CAMERA), CAMERA.camera_in_base.inverse() @ PHANTOM
    found = [finder.find(view.picture(Scene(PHANTOM))).pose for view in (rendered, DrawnView(CAMERA, BOARD))]
    for pose in found:
        way, turn = pose.distance(truth)
        assert way < 1e-4
        assert np.degrees(turn) < 0.05
    assert found[0].distance(found[1])[0] < 5e-5


def test_a_moved_board_is_seen_where_it_is(rendered):
    moved = board_below(
        HOME.tip - 0.15 * HOME.tool_direction, HOME.tool_direction + np.array([0.1, 0.05, 0]), 0.16
    )
    pose = BoardFinder(BOARD, CAMERA).find(rendered.picture(Scene(moved))).pose
    assert pose.distance(CAMERA.camera_in_base.inverse() @ moved)[0] < 1.5e-4
    back = BoardFinder(BOARD, CAMERA).find(rendered.picture(Scene(PHANTOM))).pose
    assert back.distance(CAMERA.camera_in_base.inverse() @ PHANTOM)[0] < 1e-4


def test_two_views_do_not_disturb_each_other(rendered):
    first = rendered.picture(Scene(PHANTOM))
    other = RenderedView(DATA, Camera.above(CameraSettings(width_px=320, height_px=240), PHANTOM), BOARD)
    assert other.picture(Scene(PHANTOM)).shape == (240, 320, 3)
    np.testing.assert_array_equal(rendered.picture(Scene(PHANTOM)), first)
    other.close()
    np.testing.assert_array_equal(rendered.picture(Scene(PHANTOM)), first)
    with pytest.raises(PlantError, match="closed"):
        other.picture(Scene(PHANTOM))


def test_another_arms_pose_is_refused(rendered):
    with pytest.raises(PlantError, match="7 joints"):
        rendered.picture(Scene(PHANTOM, q=np.zeros(6)))


def test_without_a_library_it_says_what_to_install(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(PlantError, match=r"install libegl1 and libgl1, or libosmesa6"):
        gl_platform()


def test_the_platform_can_be_chosen_and_switched_off(monkeypatch):
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: name if name == "OSMesa" else None)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    assert gl_platform() == "osmesa"
    monkeypatch.setenv("MUJOCO_GL", "egl")
    assert gl_platform() == "egl"
    monkeypatch.setenv("MUJOCO_GL", "off")
    with pytest.raises(PlantError, match="switched off"):
        gl_platform()
