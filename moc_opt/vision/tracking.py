"""Detect a board's pose in pictures (OpenCV's ArUco markers), reject outliers, and average the pose over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numpy as np
import pinocchio as pin
from pydantic import Field

from moc_opt.arrays import Array
from moc_opt.vision.board import Board, Pose, VisionSettings, rotation_from
from moc_opt.vision.camera import Camera, Picture, dictionary

_OUTLIER, _CLEAN_PX = 4.0, 0.6  # a corner is left out if its error exceeds 0.6 px and 4 times the median error


class TrackerSettings(VisionSettings):
    """Conditions under which a sighting (the board's pose in one picture) changes the estimated pose."""

    KIND: ClassVar[str] = "[tracker]"

    min_markers: int = Field(3, ge=1, description="a sighting of fewer markers is refused")
    error_max_px: float = Field(1.0, gt=0.0, description="a sighting with a larger rms corner error is refused")
    jump_m: float = Field(0.004, gt=0.0, description="a sighting farther than this from the estimate is an outlier")
    jump_rad: float = Field(0.05, gt=0.0, description="a sighting at a larger angle to the estimate is an outlier")
    found_after: int = Field(3, ge=1, description="number of agreeing outliers in a row that replace the estimate")
    lost_after_s: float = Field(0.12, gt=0.0, description="the board is lost if no sighting is accepted for this time")
    smoothing_s: float = Field(0.3, ge=0.0, description="time constant of the average; 0: no averaging")


@dataclass(frozen=True, eq=False)
class Sighting:
    """The board's pose measured in one picture."""

    pose: Pose  #: Of the board in the camera's frame.
    markers: int  #: Number of markers with at least two used corners.
    error_px: float  #: Root mean square error of the corners.


class BoardFinder:
    """Finds the pose of a board in pictures of one camera."""

    def __init__(self, board: Board, camera: Camera) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        # Window of the corner refinement [cells]. Compared with the default (0.3), it reduces distance errors by 25 %.
        parameters.relativeCornerRefinmentWinSize = 1.0
        self._detector = cv2.aruco.ArucoDetector(dictionary(), parameters)
        self._corners = {marker: board.corners(marker) for marker in board.ids}
        self._matrix = camera.matrix

    def corners(self, picture: Picture) -> dict[int, Array]:
        """Return the corners (4, 2) [px] of the board's markers by marker number."""
        found, ids, _ = self._detector.detectMarkers(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
        numbers = [] if ids is None else [int(marker) for marker in ids.ravel()]
        quads = (np.asarray(quad, dtype=np.float64).reshape(4, 2) for quad in found)
        return {marker: quad for marker, quad in zip(numbers, quads, strict=True) if marker in self._corners}

    def find(self, picture: Picture) -> Sighting | None:
        """Find the board's pose in the camera's frame; None if no marker is seen or no pose fits."""
        seen = self.corners(picture)
        if not seen:
            return None
        points = np.concatenate([self._corners[marker] for marker in seen])
        pixels = np.concatenate(list(seen.values()))
        # The corners of a distant plane fit two poses. Both are refined, and the better one is returned.
        _, turns, places, _ = cv2.solvePnPGeneric(points, pixels, self._matrix, None, flags=cv2.SOLVEPNP_IPPE)
        both = [self._refine(*start, points, pixels) for start in zip(turns, places, strict=True)]
        fits = [(pose, self._misses(pose, points, pixels)) for pose in both if pose is not None]
        if not fits:
            return None
        pose, misses = min(fits, key=lambda fit: float(np.median(fit[1])))
        good = misses <= max(_OUTLIER * float(np.median(misses)), _CLEAN_PX)
        if not good.all() and good.sum() >= 4:
            again = self._refine(pin.log3(pose.R), pose.t, points[good], pixels[good])
            if again is not None:
                pose, misses = again, self._misses(again, points[good], pixels[good])
        markers = int((good.reshape(-1, 4).sum(axis=1) >= 2).sum())
        return Sighting(pose, markers, math.sqrt(float((misses * misses).mean())))

    def _refine(self, turn: Any, place: Any, points: Array, pixels: Array) -> Pose | None:
        start, far = (np.array(vector, dtype=np.float64).reshape(3, 1) for vector in (turn, place))
        found = cv2.solvePnPRefineLM(points, pixels, self._matrix, None, start, far)
        turn, place = (np.asarray(part, dtype=np.float64).ravel() for part in found)
        if not (np.isfinite(turn).all() and np.isfinite(place).all() and place[2] > 0.0):
            return None
        return Pose(rotation_from(turn), place)

    def _misses(self, pose: Pose, points: Array, pixels: Array) -> Array:
        rays = pose.apply(points) @ self._matrix.T
        return np.asarray(np.linalg.norm(rays[:, :2] / rays[:, 2:] - pixels, axis=1))


@dataclass(frozen=True, eq=False)
class Tracked:
    """The tracker's result after one picture."""

    seen: bool  #: Whether the board has been found and is not lost.
    pose: Pose | None  #: Averaged pose, kept while the board is lost; None before it is found.
    refused: str | None  #: Why the sighting was not used, or None.


class BoardTracker:
    """Estimates the pose of a board, averaged over `smoothing_s`.

    If `found_after` sightings far from the estimate agree, the estimate jumps to them. The caller must make sure that
    the tip's reference does not jump with it.
    """

    def __init__(self, limits: TrackerSettings | None = None) -> None:
        self.limits = limits or TrackerSettings()
        self.pose: Pose | None = None
        self._tracking, self._time, self._last_seen = False, -math.inf, -math.inf
        self._count = 0  # number of averaged sightings
        self._streak: list[Pose] = []  # good sightings not yet in the estimate

    def update(self, t: float, sighting: Sighting | None) -> Tracked:
        """Update the estimate with the sighting, if any, at time t [s]."""
        elapsed, self._time = t - self._time, t
        refused = self._refusal(sighting)
        if sighting is None or refused is not None:
            self._streak.clear()
        elif self.pose is not None and self._tracking and self._near(self.pose, sighting.pose):
            self._streak.clear()
            self.pose = self._blend(self.pose, sighting.pose, elapsed)
            self._last_seen = t
        else:
            refused = self._confirm(sighting.pose, t)
        if self._tracking and t - self._last_seen > self.limits.lost_after_s:
            self._tracking = False
        return Tracked(self._tracking, self.pose, refused)

    def _refusal(self, sighting: Sighting | None) -> str | None:
        if sighting is None:
            return "no marker seen"
        if sighting.markers < self.limits.min_markers:
            return f"{sighting.markers} markers seen, {self.limits.min_markers} needed"
        # `not <=` also refuses a NaN.
        if not sighting.error_px <= self.limits.error_max_px:
            return f"error {sighting.error_px:.2f} px, {self.limits.error_max_px:g} px allowed"
        return None

    def _confirm(self, pose: Pose, now: float) -> str | None:
        if self._streak and not self._near(self._streak[-1], pose):
            self._streak.clear()
        self._streak.append(pose)
        if len(self._streak) < self.limits.found_after:
            return "far from the estimate" if self._tracking else "waiting for more sightings that agree"
        # If the board has moved, a new average begins.
        if self.pose is None or not self._near(self.pose, pose):
            mean, self._count = self._streak[0], 1
            for other in self._streak[1:]:
                mean = self._blend(mean, other, 0.0)
            self.pose = mean
        self._streak.clear()
        self._tracking, self._last_seen = True, now
        return None

    def _near(self, one: Pose, other: Pose) -> bool:
        way, turn = one.distance(other)
        return way <= self.limits.jump_m and turn <= self.limits.jump_rad

    def _blend(self, mean: Pose, pose: Pose, elapsed: float) -> Pose:
        self._count += 1
        total = self.limits.smoothing_s + elapsed
        steady = elapsed / total if total > 0.0 else 1.0
        return mean.towards(pose, max(steady, 1.0 / self._count))
