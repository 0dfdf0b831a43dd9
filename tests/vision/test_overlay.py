"""The overlay lies where the projection puts it, and pictures and films can be read back."""

import cv2
import numpy as np
import pytest

from moc_opt.errors import PlantError
from moc_opt.vision.camera import Camera
from moc_opt.vision.overlay import DONE, TASK, TIP, TROCAR, Overlay, save_picture, save_video
from moc_opt.vision.pose import Pose
from moc_opt.vision.settings import CameraSettings

PHANTOM = Pose(np.eye(3), (0.6, 0.0, 0.05))
CAMERA = Camera.above(CameraSettings(), PHANTOM)
BLANK = np.zeros((480, 640, 3), dtype=np.uint8)
LINE = PHANTOM.apply(np.stack([np.linspace(-0.03, 0.03, 50), np.zeros(50), np.zeros(50)], axis=1))
TIP_PLACE = PHANTOM.apply([0.0, 0.01, 0.0])


def near(picture, colour, point, reach=3):
    u, v = np.rint(CAMERA.project(point)[0]).astype(int)
    patch = picture[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1].reshape(-1, 3)
    return bool((np.abs(patch.astype(int) - colour).max(axis=1) < 40).any())


def test_task_progress_and_tip_are_where_they_project_to():
    page = Overlay(CAMERA).draw(BLANK, task=LINE, progress=0.5, tip=TIP_PLACE)
    assert near(page, DONE, LINE[5])
    assert near(page, TASK, LINE[45])
    assert not near(page, TASK, LINE[5])
    assert near(page, TIP, TIP_PLACE)
    assert not BLANK.any()


def test_the_way_to_the_trocar_is_drawn_even_if_it_is_behind_the_camera():
    for trocar in (PHANTOM.apply([0.0, 0.02, 0.15]), PHANTOM.apply([0.0, 0.0, 1.0])):
        page = Overlay(CAMERA).draw(BLANK, tip=TIP_PLACE, trocar=trocar)
        just_above = TIP_PLACE + 0.2 * (trocar - TIP_PLACE) / np.linalg.norm(trocar - TIP_PLACE) * 0.15
        assert near(page, TROCAR, just_above)


def test_nothing_to_draw_is_no_error():
    behind = CAMERA.camera_in_base.apply([0.0, 0.0, -0.1])
    page = Overlay(CAMERA).draw(BLANK, task=[behind, behind], tip=behind, trocar=PHANTOM.t)
    np.testing.assert_array_equal(page, BLANK)
    assert Overlay(CAMERA).draw(BLANK, text="lost").any()


def test_pictures_are_written(tmp_path):
    page = Overlay(CAMERA).draw(BLANK, task=LINE)
    save_picture(tmp_path / "one.png", page)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "one.png")), page)
    with pytest.raises(PlantError, match="folder does not exist"):
        save_picture(tmp_path / "nowhere" / "one.png", page)
    with pytest.raises(PlantError, match=r"\.png"):
        save_picture(tmp_path / "one.xyz", page)


@pytest.mark.parametrize("suffix", [".webm", ".mp4", ".avi", ""])
def test_films_can_be_read_back(tmp_path, suffix):
    pictures = [np.full((120, 160, 3), 20 * k, dtype=np.uint8) for k in range(6)]
    file = tmp_path / f"film{suffix}"
    assert save_video(file, iter(pictures), 30.0) == 6
    if suffix:
        film = cv2.VideoCapture(str(file))
        read = [film.read() for _ in range(7)]
        film.release()
        frames = [frame for ok, frame in read if ok]
    else:
        frames = [cv2.imread(str(name)) for name in sorted(file.iterdir())]
    assert len(frames) == 6
    np.testing.assert_allclose([frame.mean() for frame in frames], [20 * k for k in range(6)], atol=6)


def test_bad_films_are_refused(tmp_path):
    with pytest.raises(PlantError, match=r"\.webm, \.mp4, \.avi"):
        save_video(tmp_path / "film.gif", [BLANK], 30.0)
    with pytest.raises(PlantError, match="no pictures"):
        save_video(tmp_path / "film.avi", [], 30.0)
    with pytest.raises(PlantError, match="picture 1"):
        save_video(tmp_path / "film.avi", [BLANK, BLANK[:100]], 30.0)
    with pytest.raises(PlantError, match="rate_Hz"):
        save_video(tmp_path / "film.avi", [BLANK], 0.0)
    with pytest.raises(PlantError, match="folder does not exist"):
        save_video(tmp_path / "nowhere" / "film.avi", [BLANK], 30.0)
