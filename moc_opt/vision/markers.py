"""The board as a picture, and the board found again in a picture: OpenCV's ArUco markers."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.vision.board import Board
from moc_opt.vision.camera import Camera, Picture
from moc_opt.vision.pose import Pose, rotation_from, rotation_vector
from moc_opt.vision.tracking import Sighting

_MARKER_BITS = 6  # 4 x 4 bits and a black frame around them
_OUTLIER, _CLEAN_PX = 4.0, 0.6  # a corner this many medians off is left out, unless it is this near anyway


def board_picture(board: Board, cell_px: int = 16) -> NDArray[np.uint8]:
    """Draw the board as it is printed (H, W), grey levels.

    Args:
        cell_px: pixels along one cell of a marker, which is a sixth of its side.
    """
    side = _MARKER_BITS * cell_px
    scale = side / board.marker_m
    width, height = (math.ceil(scale * size - 1e-6) for size in board.size_m)
    rim = 2  # room for a marker's white frame where it reaches over the edge
    page = np.full((height + 2 * rim, width + 2 * rim), 255, dtype=np.uint8)
    dictionary, to_pixel = _dictionary(), texture_matrix(board, cell_px)
    for marker in board.ids:
        left, top = (to_pixel @ [*board.corners(marker)[0, :2], 1.0])[:2] + 0.5
        column, row = math.floor(left + 1e-6), math.floor(top + 1e-6)
        # A marker that begins inside a pixel is drawn there: rounded, it would be up to 0.1 mm out of place.
        part = np.array([[1.0, 0.0, max(left - column, 0.0)], [0.0, 1.0, max(top - row, 0.0)]])
        square = np.pad(cv2.aruco.generateImageMarker(dictionary, marker, side), rim, constant_values=255)
        square = cv2.warpAffine(square, part, square.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
        place = np.s_[row : row + side + 2 * rim, column : column + side + 2 * rim]
        page[place] = np.minimum(page[place], square)
    return np.ascontiguousarray(page[rim:-rim, rim:-rim])


def texture_matrix(board: Board, cell_px: int = 16) -> Array:
    """Map x, y, 1 on the board [m] to column, row, 1 in `board_picture`, (3, 3); a pixel's number is its middle."""
    scale = _MARKER_BITS * cell_px / board.marker_m
    width, height = board.size_m
    return np.array(
        [[scale, 0.0, 0.5 * scale * width - 0.5], [0.0, -scale, 0.5 * scale * height - 0.5], [0.0, 0.0, 1.0]]
    )


class BoardFinder:
    """Finds one board in pictures of one camera: markers, sub-pixel corners, pose by PnP and refinement."""

    def __init__(self, board: Board, camera: Camera) -> None:
        """Set up the detector; of the camera only its intrinsics are used."""
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        # A window as wide as a cell, where OpenCV takes a third of one: a quarter less error in the distance.
        parameters.relativeCornerRefinmentWinSize = 1.0
        self._detector = cv2.aruco.ArucoDetector(_dictionary(), parameters)
        self._corners = {marker: board.corners(marker) for marker in board.ids}
        self._matrix = camera.matrix

    def corners(self, picture: Picture) -> dict[int, Array]:
        """Return the corners (4, 2) [px] of every marker of the board that is seen, by its number."""
        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        found, ids, _ = self._detector.detectMarkers(grey)
        if ids is None:
            return {}
        quads = [np.asarray(quad, dtype=np.float64).reshape(4, 2) for quad in found]
        pairs = zip(map(int, ids.ravel()), quads, strict=True)
        return {marker: quad for marker, quad in pairs if marker in self._corners}

    def find(self, picture: Picture) -> Sighting | None:
        """Find the board's pose in the camera's frame; None where no marker is seen or no pose fits.

        A plane seen from afar fits two poses (mirrored about the line of sight): both are computed (IPPE) and
        refined by Levenberg-Marquardt on all corners, and the better one is taken. Corners far off it, mostly where
        the tool's edge crosses a marker, are then left out, and the rest is refined again.

        Args:
            picture: (H, W) or (H, W, 3).
        """
        seen = self.corners(picture)
        if not seen:
            return None
        points = np.concatenate([self._corners[marker] for marker in seen])
        pixels = np.concatenate(list(seen.values()))
        count, turns, places, _ = cv2.solvePnPGeneric(points, pixels, self._matrix, None, flags=cv2.SOLVEPNP_IPPE)
        both = [self._refine(_column(turns[i]), _column(places[i]), points, pixels) for i in range(count)]
        fits = [(pose, self._misses(pose, points, pixels)) for pose in both if pose is not None]
        if not fits:
            return None
        pose, misses = min(fits, key=lambda fit: float(np.median(fit[1])))
        good = misses <= max(_OUTLIER * float(np.median(misses)), _CLEAN_PX)
        if not good.all() and good.sum() >= 4:
            start = _column(rotation_vector(pose.R)), _column(pose.t)
            again = self._refine(*start, points[good], pixels[good])
            if again is not None:
                pose, misses = again, self._misses(again, points[good], pixels[good])
        markers = int((good.reshape(-1, 4).sum(axis=1) >= 2).sum())
        return Sighting(pose, markers, math.sqrt(float((misses * misses).mean())))

    def _refine(self, turn: Array, place: Array, points: Array, pixels: Array) -> Pose | None:
        """Return the nearest pose of least squares; None where it is not in front of the camera."""
        found = cv2.solvePnPRefineLM(points, pixels, self._matrix, None, turn, place)
        turn, place = (np.asarray(part, dtype=np.float64).ravel() for part in found)
        if not (np.isfinite(turn).all() and np.isfinite(place).all() and place[2] > 0.0):
            return None
        return Pose(rotation_from(turn), place)

    def _misses(self, pose: Pose, points: Array, pixels: Array) -> Array:
        """Return the distances (k,) of the corners seen from where the pose puts them [px]."""
        rays = pose.apply(points) @ self._matrix.T
        return np.asarray(np.linalg.norm(rays[:, :2] / rays[:, 2:] - pixels, axis=1))


def _column(vector: ArrayLike) -> Array:
    """Return (3, 1), a copy: OpenCV's refinement writes into what it is given."""
    return np.array(vector, dtype=np.float64).reshape(3, 1)


@lru_cache(maxsize=1)
def _dictionary() -> Any:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
