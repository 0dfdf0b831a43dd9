"""Where the pictures come from: MuJoCo's renderer or the drawn pinhole, and how well the board is found in them."""

from __future__ import annotations

import numpy as np

from moc_opt.errors import PlantError
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.vision.board import Board
from moc_opt.vision.camera import Camera, Scene, View, hide
from moc_opt.vision.markers import BoardFinder
from moc_opt.vision.pinhole import DrawnView
from moc_opt.vision.pose import Pose, rotation_from
from moc_opt.vision.settings import BoardSettings, CameraSettings


def make_view(robot: RobotModel, camera: Camera, board: Board, *, seed: int = 0) -> tuple[View, str | None]:
    """Make the source of pictures that the camera's settings ask for, and why it is not MuJoCo if "auto" wanted that.

    Raises:
        PlantError: "mujoco" was asked for and cannot be used here.
    """
    source, why = camera.settings.source, None
    if source != "drawn":
        # Late, so that a machine without GL libraries never loads what needs them.
        from moc_opt.vision.render import RenderedView

        try:
            return RenderedView(robot.data, camera, board, seed=seed), None
        except PlantError as error:
            if source == "mujoco":
                raise
            why = str(error)

    def shaft(q: Array) -> tuple[Array, Array]:
        state = robot.state(q)
        return state.tip, state.wrist

    return DrawnView(camera, board, shaft=shaft, seed=seed), why


def pose_accuracy(
    robot: RobotModel, camera: CameraSettings | None = None, board: BoardSettings | None = None, *, poses: int = 100,
    seed: int = 0,
) -> dict[str, float]:  # fmt: skip
    """Measure single pictures: the board found at random poses before the camera, against the truth.

    The board is 0.12 to 0.20 m away, up to 35 degrees from facing the camera and turned as it likes within 45,
    1 cm out of the middle at most. Calibration plays no part.

    Returns:
        seen (share of the pictures), position_median_mm, position_p95_mm, angle_median_deg, angle_p95_deg,
        fit_median_px, markers_mean.
    """
    settings = BoardSettings() if board is None else board
    sheet = settings.board()
    eye = Camera(CameraSettings() if camera is None else camera, Pose(np.diag([1.0, -1.0, -1.0]), (0.6, 0.0, 0.4)))
    view, _ = make_view(robot, eye, sheet, seed=seed)
    finder = BoardFinder(sheet, eye)
    rng = np.random.default_rng(seed)
    found: list[tuple[float, float, float, float]] = []
    for k in range(poses):
        truth = _random_pose(rng)
        hidden = hide(sheet.ids, settings.hidden_fraction, seed + k)
        sighting = finder.find(view.picture(Scene(eye.camera_in_base @ truth, hidden)))
        if sighting is not None:
            found.append((*sighting.pose.distance(truth), sighting.error_px, sighting.markers))
    figures = np.array(found).reshape(-1, 4) if found else np.full((1, 4), np.nan)
    way, turn = 1e3 * figures[:, 0], np.degrees(figures[:, 1])
    return {
        "seen": len(found) / poses, "position_median_mm": float(np.median(way)),
        "position_p95_mm": float(np.percentile(way, 95)), "angle_median_deg": float(np.median(turn)),
        "angle_p95_deg": float(np.percentile(turn, 95)), "fit_median_px": float(np.median(figures[:, 2])),
        "markers_mean": float(figures[:, 3].mean()),
    }  # fmt: skip


def _random_pose(rng: np.random.Generator) -> Pose:
    """Return a board in the camera's frame, its printed side to the camera."""
    facing = np.diag([1.0, -1.0, -1.0])
    spin = rotation_from((0.0, 0.0, rng.uniform(-0.25, 0.25) * np.pi))
    angle, tilt = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(0.0, 35.0))
    lean = rotation_from(tilt * np.array([np.cos(angle), np.sin(angle), 0.0]))
    place = (*rng.uniform(-0.01, 0.01, 2), rng.uniform(0.12, 0.20))
    return Pose(lean @ facing @ spin, place)
