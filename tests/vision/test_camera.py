"""The camera: projection, its place above the phantom, its calibration, its sensor, and settings that speak."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import PlantError, UnknownNameError
from moc_opt.vision.board import Board
from moc_opt.vision.camera import Camera, Sensor, hide
from moc_opt.vision.pose import Pose, rotation_from
from moc_opt.vision.settings import BoardSettings, CameraSettings, TrackerSettings

PHANTOM = Pose(rotation_from((0.1, 0.2, 0.3)), (0.6, 0.1, 0.05))
CAMERA = Camera.above(CameraSettings(), PHANTOM)


def test_the_middle_of_the_phantom_is_the_middle_of_the_picture():
    np.testing.assert_allclose(CAMERA.project(PHANTOM.t), [[319.5, 239.5]], atol=1e-9)


def test_the_angle_of_view_spans_the_picture_from_edge_to_edge():
    """The outermost pixels' outer edges are half a pixel beyond their middles."""
    up = np.tan(np.radians(25.0))
    top = CAMERA.camera_in_base.apply([0.0, -up, 1.0])
    side = CAMERA.camera_in_base.apply([up * 640 / 480, 0.0, 1.0])
    np.testing.assert_allclose(CAMERA.project([top, side]), [[319.5, -0.5], [639.5, 239.5]], atol=1e-9)


def test_it_stands_where_the_settings_say():
    eye = PHANTOM.inverse().apply(CAMERA.camera_in_base.t)
    assert np.linalg.norm(eye) == pytest.approx(0.16)
    assert np.degrees(np.arccos(eye[2] / 0.16)) == pytest.approx(25.0)
    assert eye[1] < 0.0
    # The board's y is upwards in the picture, its x to the right.
    middle, right, up = CAMERA.project(PHANTOM.apply([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]))
    assert right[0] > middle[0]
    assert up[1] < middle[1]


@given(st.tuples(*[st.floats(-0.5, 0.5)] * 2), st.floats(0.05, 1.0))
def test_projection_is_the_pinhole(direction, depth):
    point = CAMERA.camera_in_base.apply(depth * np.array([*direction, 1.0]))
    expected = CAMERA.focal_px * np.array(direction) + [319.5, 239.5]
    np.testing.assert_allclose(CAMERA.project(point)[0], expected, atol=1e-6)


def test_what_is_behind_is_not_projected():
    behind = CAMERA.camera_in_base.apply([0.0, 0.0, -0.1])
    assert np.isnan(CAMERA.project(behind)).all()


def test_calibration_is_off_by_what_was_asked_for():
    settings = CameraSettings(calibration_error_m=0.002, calibration_error_deg=0.5)
    camera = Camera.above(settings, PHANTOM)
    way, turn = camera.camera_in_base.distance(camera.miscalibrated(3).camera_in_base)
    assert way == pytest.approx(0.002)
    assert np.degrees(turn) == pytest.approx(0.5)
    exact = Camera.above(CameraSettings(calibration_error_m=0, calibration_error_deg=0), PHANTOM)
    assert exact.camera_in_base.distance(exact.miscalibrated(3).camera_in_base)[0] == pytest.approx(
        0.0, abs=1e-12
    )
    again = camera.miscalibrated(3).camera_in_base
    assert camera.miscalibrated(4).camera_in_base.distance(again)[0] > 1e-4


def test_the_sensor_blurs_and_adds_noise():
    picture = np.full((200, 200, 3), 128, dtype=np.uint8)
    grey = Sensor(CameraSettings(noise=5.0, blur_px=0.0), 0).expose(picture).astype(float)
    assert grey.std() == pytest.approx(5.0, rel=0.05)
    assert grey.mean() == pytest.approx(128.0, abs=0.2)
    picture[:, 100:] = 228
    edge = Sensor(CameraSettings(noise=0.0, blur_px=2.0), 0).expose(picture)[100, :, 0].astype(float)
    slope = np.diff(edge) / 100
    place = np.arange(len(slope)) - 99
    assert np.sqrt((slope * place**2).sum()) == pytest.approx(2.0, rel=0.05)
    exact = Sensor(CameraSettings(noise=0.0, blur_px=0.0), 0).expose(picture)
    np.testing.assert_array_equal(exact, picture)


def test_the_same_seed_gives_the_same_pictures():
    picture = np.full((50, 50, 3), 128, dtype=np.uint8)
    one, other, third = (Sensor(CameraSettings(), seed).expose(picture) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, other)
    assert (one != third).any()


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(0, 100))
def test_hiding_more_hides_the_same_ones_too(one, other, seed):
    ids = Board().ids
    few, many = (hide(ids, fraction, seed) for fraction in sorted((one, other)))
    assert few <= many <= set(ids)
    assert len(few) == round(min(one, other) * 20)


def test_a_share_above_one_cannot_be_hidden():
    with pytest.raises(PlantError, match=r"hidden_fraction = 1\.5"):
        hide(Board().ids, 1.5, 0)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: CameraSettings(fov_deg=200), r"\[camera\] fov_deg = 200"),
        (lambda: CameraSettings(source="vulkan"), r"\[camera\] source = 'vulkan'"),
        (lambda: BoardSettings(hidden_fraction=-0.1), r"\[board\] hidden_fraction"),
        (lambda: BoardSettings(lost_s=((3.0, 2.0),)), r"lost_s = \[3\.0, 2\.0\]"),
        (lambda: BoardSettings(columns=20, rows=20), "250 markers"),
        (lambda: TrackerSettings(found_after=0), r"\[tracker\] found_after = 0"),
    ],
)
def test_settings_out_of_range_name_field_and_value(build, message):
    with pytest.raises(PlantError, match=message):
        build()


def test_an_unknown_setting_lists_the_nearest():
    with pytest.raises(UnknownNameError, match="fov_deg"):
        CameraSettings(fov=50)


def test_settings_make_what_they_describe():
    assert BoardSettings().board() == Board()
    lost = BoardSettings(lost_s=((1.0, 2.0), (3.0, 4.0)))
    assert [lost.is_lost(t) for t in (0.5, 1.0, 1.99, 2.0, 3.5)] == [False, True, True, False, True]
