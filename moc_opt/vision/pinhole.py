"""The camera's picture drawn through the pinhole model, for machines without a GL library."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.vision.board import Board
from moc_opt.vision.camera import Camera, Picture, Scene, Sensor
from moc_opt.vision.markers import board_picture, texture_matrix

Shaft = Callable[[Array], tuple[Array, Array]]

TISSUE, COVER, STEEL = (92, 100, 178), (70, 60, 150), (150, 148, 145)  # blue, green, red
SHAFT_RADIUS_M = 0.004  # of the tool as it is drawn
_FINER = 2  # pixels drawn for each pixel of the picture, each way: the markers' edges come out smooth


class DrawnView:
    """Draws the board by a perspective warp, covers and the tool's shaft as polygons, then exposes the sensor."""

    def __init__(self, camera: Camera, board: Board, *, shaft: Shaft | None = None, seed: int = 0) -> None:
        """Prepare.

        Args:
            camera: the true camera.
            shaft: pose q (n,) of the arm -> tip (3,) and another point (3,) of its shaft, base frame [m];
                None: the tool is not drawn.
        """
        self._camera, self._board, self._shaft = camera, board, shaft
        self._page = cv2.cvtColor(board_picture(board), cv2.COLOR_GRAY2BGR)
        self._to_board = np.linalg.inv(texture_matrix(board))
        self._sensor = Sensor(camera.settings, seed)
        # The middle of pixel u of the picture is at 2 u + 0.5 in the finer one.
        self._finer = np.array([[_FINER, 0.0, 0.5 * (_FINER - 1)], [0.0, _FINER, 0.5 * (_FINER - 1)], [0.0, 0.0, 1.0]])

    @property
    def camera(self) -> Camera:
        """The true camera."""
        return self._camera

    def picture(self, scene: Scene) -> Picture:
        """Take the camera's picture (H, W, 3), blue green red."""
        width, height = self._camera.size_px
        page = np.full((_FINER * height, _FINER * width, 3), TISSUE, dtype=np.uint8)
        pose = self._camera.camera_in_base.inverse() @ scene.board_in_base
        faces = float(pose.R[:, 2] @ pose.t) < 0.0 and float(pose.apply(self._board.outline())[:, 2].min()) > 1e-3
        if faces and not scene.dark:
            flat = np.stack([pose.R[:, 0], pose.R[:, 1], pose.t], axis=1)
            onto = self._finer @ self._camera.matrix @ flat @ self._to_board
            cv2.warpPerspective(
                self._page, onto, page.shape[1::-1], dst=page, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT
            )
            for marker in scene.hidden:
                spot = scene.board_in_base.apply(_cover(self._board, marker))
                self._fill(page, spot, COVER)
        if self._shaft is not None and scene.q is not None:
            self._draw_shaft(page, *self._shaft(scene.q))
        small = np.asarray(cv2.resize(page, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return self._sensor.expose(small)

    def _draw_shaft(self, page: Picture, tip: Array, other: Array) -> None:
        """Draw the shaft as its silhouette: the tip and the farthest point that is still before the lens."""
        to_camera = self._camera.camera_in_base.inverse()
        near, far = to_camera.apply(tip), to_camera.apply(other)
        least = 0.005
        if near[2] <= least:
            return
        if far[2] < least:
            far = near + (near[2] - least) / (near[2] - far[2]) * (far - near)
        side = np.cross(far - near, near)
        side = SHAFT_RADIUS_M * side / max(float(np.linalg.norm(side)), 1e-12)
        quad = np.array([near + side, far + side, far - side, near - side])
        self._fill(page, self._camera.camera_in_base.apply(quad), STEEL)

    def _fill(self, page: Picture, points_in_base: Array, colour: tuple[int, int, int]) -> None:
        """Fill a polygon (k, 3) [m]; 1/16 pixel fine."""
        pixels = self._camera.project(points_in_base) @ self._finer[:2, :2].T + self._finer[:2, 2]
        if np.isfinite(pixels).all() and np.abs(pixels).max() < 1e5:
            corners = np.rint(16.0 * pixels).astype(np.int32)
            cv2.fillConvexPoly(page, corners, colour, lineType=cv2.LINE_AA, shift=4)


def _cover(board: Board, marker: int) -> Array:
    """Return a round patch (k, 3) over a marker, in the board's frame [m]: it hides all four corners."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    middle = board.corners(marker).mean(axis=0)
    return np.asarray(middle + cover_radius(board) * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1))


def cover_radius(board: Board) -> float:
    """Return the radius of a patch that hides a marker [m]: not so large that it reaches into the neighbours."""
    return min(0.72 * board.marker_m, 0.5 * board.marker_m + 0.9 * board.gap_m)
