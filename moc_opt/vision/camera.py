"""The endoscope's camera: settings, pinhole model and pictures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from moc_opt.arrays import Array
from moc_opt.vision.board import Board, Pose, VisionSettings, rotation_from

Picture = NDArray[np.uint8]  # (H, W, 3), blue green red

TISSUE, COVER, STEEL = (92, 100, 178), (70, 60, 150), (150, 148, 145)
SHAFT_RADIUS_M = 0.004
_MARKER_BITS = 6  # cells along a marker's side: 4 bits between two cells of black frame
_CELL_PX = 16  # pixels along one cell of the drawn board
_FINER = 2  # the scene is drawn this many times finer than the picture


class CameraSettings(VisionSettings):
    """An endoscope without lens distortion. It looks at the phantom through its own port."""

    KIND: ClassVar[str] = "[camera]"

    width_px: int = Field(640, ge=64, le=4096)
    height_px: int = Field(480, ge=64, le=4096)
    fov_deg: float = Field(50.0, ge=10.0, le=120.0, description="angle of view from top to bottom")
    rate_Hz: float = Field(30.0, gt=0.0, le=500.0, description="pictures per second")
    distance_m: float = Field(0.16, ge=0.02, le=1.0, description="distance from the middle of the phantom's board")
    tilt_deg: float = Field(25.0, ge=0.0, le=75.0, description="angle of the line of sight to the board's normal")
    azimuth_deg: float = Field(-90.0, description="direction of the camera around the normal, from the board's x")
    blur_px: float = Field(0.7, ge=0.0, le=10.0, description="standard deviation of the lens's blur")
    noise: float = Field(3.0, ge=0.0, le=100.0, description="standard deviation of the noise [grey levels of 255]")
    calibration_error_m: float = Field(0.0005, ge=0.0, le=0.05)
    """distance of the camera from its calibrated place"""
    calibration_error_deg: float = Field(0.1, ge=0.0, le=10.0, description="angle error of the calibration")


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera and its pose. Its frame is OpenCV's: x right, y down, z along the view."""

    settings: CameraSettings
    camera_in_base: Pose

    @property
    def matrix(self) -> Array:
        """The camera matrix (3, 3). Pixel centres have whole coordinates."""
        width, height = self.settings.width_px, self.settings.height_px
        f = 0.5 * height / math.tan(0.5 * math.radians(self.settings.fov_deg))
        return np.array([[f, 0.0, 0.5 * width - 0.5], [0.0, f, 0.5 * height - 0.5], [0.0, 0.0, 1.0]])

    def project(self, points_in_base: ArrayLike) -> Array:
        """Return the pixels (k, 2) of points (k, 3) [m] in the base frame; NaN behind the camera."""
        points = self.camera_in_base.inverse().apply(np.atleast_2d(np.asarray(points_in_base, dtype=np.float64)))
        depth = np.where(points[:, 2] > 1e-6, points[:, 2], np.nan)
        return np.asarray((points @ self.matrix.T)[:, :2] / depth[:, None])

    @classmethod
    def above(cls, settings: CameraSettings, phantom_in_base: Pose) -> Camera:
        """Place a camera that looks at the middle of the phantom's board."""
        tilt, azimuth = math.radians(settings.tilt_deg), math.radians(settings.azimuth_deg)
        away = np.array([math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)])
        right = np.cross(-away, (0.0, 1.0, 0.0))  # not zero, because the tilt is below 90 degrees
        right /= np.linalg.norm(right)
        turn = np.stack([right, np.cross(-away, right), -away], axis=1)
        return cls(settings, phantom_in_base @ Pose(turn, settings.distance_m * away))

    def miscalibrated(self, seed: int) -> Camera:
        """Return the camera with the settings' calibration errors, in random directions."""
        away, axis = np.random.default_rng(seed).standard_normal((2, 3))
        turn = math.radians(self.settings.calibration_error_deg) * axis / np.linalg.norm(axis)
        error = Pose(rotation_from(turn), self.settings.calibration_error_m * away / np.linalg.norm(away))
        return Camera(self.settings, self.camera_in_base @ error)


def hide(ids: range, fraction: float, seed: int) -> frozenset[int]:
    """Choose at random which markers are covered: a share ``fraction`` (0 to 1) of all."""
    order = np.random.default_rng(seed).permutation(np.array(ids))
    return frozenset(order[: round(fraction * len(ids))].tolist())


class View:
    """Takes pictures of the board and the tool's shaft.

    ``shaft`` maps a pose q (n,) to two points (3,) of the shaft in the base frame [m], the tip first.
    """

    def __init__(
        self, camera: Camera, board: Board, *, shaft: Callable[[Array], tuple[Array, Array]] | None = None,
        seed: int = 0,
    ) -> None:  # fmt: skip
        self.camera, self._board, self._shaft = camera, board, shaft
        self._page = cv2.cvtColor(board_picture(board), cv2.COLOR_GRAY2BGR)
        self._texture = texture_matrix(board)
        self._rng = np.random.default_rng(seed)
        # With _FINER = 2, the centre of pixel u is at 2 u + 0.5.
        self._finer = np.array([[_FINER, 0.0, 0.5 * (_FINER - 1)], [0.0, _FINER, 0.5 * (_FINER - 1)], [0.0, 0.0, 1.0]])

    def picture(
        self, board_in_base: Pose | None, hidden: frozenset[int] = frozenset(), q: Array | None = None
    ) -> Picture:
        """Take a picture (H, W, 3) of the board and, at q (n,), of the tool."""
        width, height = self.camera.settings.width_px, self.camera.settings.height_px
        page = np.full((_FINER * height, _FINER * width, 3), TISSUE, dtype=np.uint8)
        if board_in_base is not None:
            self._draw_board(page, self.camera.camera_in_base.inverse() @ board_in_base, hidden)
        if self._shaft is not None and q is not None:
            self._draw_shaft(page, *self._shaft(q))
        small = np.asarray(cv2.resize(page, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return expose(small, self.camera.settings, self._rng)

    def _draw_board(self, page: Picture, pose: Pose, hidden: frozenset[int]) -> None:
        printed, board = self._page.copy(), self._board
        if pose.R[:, 2] @ pose.t >= 0.0 or pose.apply(board.outline())[:, 2].min() <= 1e-3:
            return  # the board faces away, or a part is behind the camera
        radius = min(0.72 * board.marker_m, 0.5 * board.marker_m + 0.9 * board.gap_m) * self._texture[0, 0]
        for marker in hidden:
            x, y, _ = self._texture @ [*board.corners(marker)[:, :2].mean(axis=0), 1.0]
            cv2.circle(printed, (round(x), round(y)), round(radius), COVER, cv2.FILLED, cv2.LINE_AA)
        flat = np.stack([pose.R[:, 0], pose.R[:, 1], pose.t], axis=1)
        onto = self._finer @ self.camera.matrix @ flat @ np.linalg.inv(self._texture)
        cv2.warpPerspective(
            printed, onto, page.shape[1::-1], dst=page, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT
        )

    def _draw_shaft(self, page: Picture, tip: Array, other: Array) -> None:
        to_camera, least = self.camera.camera_in_base.inverse(), 0.005
        near, far = to_camera.apply(tip), to_camera.apply(other)
        if near[2] <= least:
            return
        if far[2] < least:
            far = near + (near[2] - least) / (near[2] - far[2]) * (far - near)
        side = np.cross(far - near, near)
        side = SHAFT_RADIUS_M * side / max(float(np.linalg.norm(side)), 1e-12)
        quad = np.array([near + side, far + side, far - side, near - side])
        pixels = self.camera.project(self.camera.camera_in_base.apply(quad))
        pixels = pixels @ self._finer[:2, :2].T + self._finer[:2, 2]
        if np.isfinite(pixels).all() and np.abs(pixels).max() < 1e5:
            cv2.fillConvexPoly(page, np.rint(16.0 * pixels).astype(np.int32), STEEL, lineType=cv2.LINE_AA, shift=4)


def expose(picture: Picture, settings: CameraSettings, rng: np.random.Generator) -> Picture:
    """Return the picture with blur and noise."""
    if settings.blur_px > 0.0:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), settings.blur_px), dtype=np.uint8)
    if settings.noise > 0.0:
        # The detection uses only grey levels, so all colours get the same noise.
        grain = np.rint(settings.noise * rng.standard_normal(picture.shape[:2], dtype=np.float32))
        picture = np.clip(picture.astype(np.int16) + grain.astype(np.int16)[:, :, None], 0, 255).astype(np.uint8)
    return picture


def board_picture(board: Board) -> NDArray[np.uint8]:
    """Draw the printed board (H, W) in grey levels."""
    side = _MARKER_BITS * _CELL_PX
    width, height = (math.ceil(side / board.marker_m * size - 1e-6) for size in board.size_m)
    page = np.full((height, width), 255, dtype=np.uint8)
    for marker in board.ids:
        left, top, _ = texture_matrix(board) @ [*board.corners(marker)[0, :2], 1.0]
        # Rounding to whole pixels would move a marker by up to 0.1 mm.
        shift = np.array([[1.0, 0.0, left - 0.5], [0.0, 1.0, top - 0.5]])
        square = np.pad(cv2.aruco.generateImageMarker(dictionary(), marker, side), 1, constant_values=255)
        cv2.warpAffine(square, shift, (width, height), dst=page, borderMode=cv2.BORDER_TRANSPARENT)
    return page


def texture_matrix(board: Board) -> Array:
    """Return the matrix (3, 3) from (x, y, 1) [m] on the board to pixels of `board_picture`."""
    scale = _MARKER_BITS * _CELL_PX / board.marker_m
    width, height = board.size_m
    right, down = 0.5 * scale * width - 0.5, 0.5 * scale * height - 0.5
    return np.array([[scale, 0.0, right], [0.0, -scale, down], [0.0, 0.0, 1.0]])


@lru_cache(maxsize=1)
def dictionary() -> Any:
    """Return OpenCV's dictionary of 250 ArUco markers of 4 x 4 bits."""
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
