"""Augmented reality: an endoscope tracks a marker board with a virtual task, and films the run."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import Array
from moc_opt.errors import PlantError, TaskError
from moc_opt.robots.model import RobotModel
from moc_opt.tasks import Path
from moc_opt.trace.trace import Trace
from moc_opt.vision.board import Board, BoardTask, Pose
from moc_opt.vision.camera import Camera, CameraSettings, Picture, View, hide
from moc_opt.vision.tracking import BoardFinder, BoardTracker, Tracked, TrackerSettings

_SEARCH_S, _LOOK_S = 2.0, 1.0
_ON_PATH_M = 0.001
TASK, DONE, TIP, TROCAR, TEXT = (80, 220, 60), (200, 140, 20), (0, 215, 255), (255, 120, 240), (255, 255, 255)
_CODEC = "VP80"  # needs no system libraries, and browsers play it
_NEAR_M = 0.01


class Augmented:
    """An endoscope above a phantom's board. `camera` has the endoscope's true pose, `believed` the calibrated one."""

    def __init__(
        self, robot: RobotModel, phantom_in_base: Pose, *, camera: CameraSettings | None = None,
        board: Board | None = None, tracker: TrackerSettings | None = None, seed: int = 0,
    ) -> None:  # fmt: skip
        self.board, self.phantom = board or Board(), phantom_in_base
        noise, calibration, hidden = np.random.SeedSequence(seed).generate_state(3).tolist()
        self.camera = Camera.above(camera or CameraSettings(), phantom_in_base)
        self.believed = self.camera.miscalibrated(calibration)
        self._hidden = hide(self.board.ids, self.board.hidden_fraction, hidden)

        def shaft(q: Array) -> tuple[Array, Array]:
            state = robot.state(q)
            return state.tip, state.wrist

        self._view = View(self.camera, self.board, shaft=shaft, seed=noise)
        self._finder = BoardFinder(self.board, self.believed)
        self._tracker = BoardTracker(tracker)

    def locate(self, q: ArrayLike | None = None) -> Pose:
        """Search for the board before t = 0, and return its averaged pose in the base frame.

        The arm rests at q (n,), or is out of sight if q is None. Raise a TaskError if the board is not found in 3 s.
        """
        self._tracker = BoardTracker(self._tracker.limits)
        rate = self.camera.settings.rate_Hz
        count, wanted = round((_SEARCH_S + _LOOK_S) * rate) + 1, math.ceil(_LOOK_S * rate)
        refused: Counter[str] = Counter()
        found: list[Pose] = []
        for k in range(count):
            tracked = self._look((k - count) / rate, q)
            refused[tracked.refused or "seen"] += 1
            if tracked.seen and tracked.pose is not None:
                found.append(tracked.pose)
                if len(found) > wanted:
                    break
        if not found:
            reasons = "; ".join(f"{reason} ({times} pictures)" for reason, times in refused.most_common(3))
            raise TaskError(
                f"board: never seen in {count} pictures: {reasons}. Uncover it (hidden_fraction = "
                f"{self.board.hidden_fraction:g}), point the camera at it (distance_m, tilt_deg, fov_deg), or "
                "lower min_markers"
            )
        return found[-1]

    def watch(self, seconds: float, q: ArrayLike | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """Track the board after `locate`. Return picture times [s], and whether the board is tracked."""
        rate = self.camera.settings.rate_Hz
        times = np.arange(math.floor(seconds * rate) + 1) / rate
        return times, np.array([self._look(t, q).seen for t in times.tolist()])

    def accuracy(self, estimate: Pose, task: BoardTask) -> dict[str, float]:
        """Return the errors of an estimated board pose in the base frame.

        ``task_error_max_mm`` is the largest distance of a point of the task from its true place.
        """
        way, turn = estimate.distance(self.phantom)
        true, believed = (self.board.task_in_base(task, pose) for pose in (self.phantom, estimate))
        s = np.linspace(0.0, true.length, 200)
        off = np.linalg.norm(true.at(s)[0] - believed.at(np.minimum(s, believed.length))[0], axis=1)
        return {
            "board_position_mm": 1e3 * way, "board_angle_deg": math.degrees(turn),
            "task_error_max_mm": 1e3 * float(off.max()),
        }  # fmt: skip

    def film(self, file: str | os.PathLike[str], trace: Trace, path: Path, trocar: ArrayLike) -> int:
        """Film the run (.webm), with a line to the registered ``trocar`` (3,) [m]. Return the number of pictures."""
        return save_film(file, self._frames(trace, path, trocar), self.camera.settings.rate_Hz)

    def _frames(self, trace: Trace, path: Path, trocar: ArrayLike) -> Iterator[Picture]:
        line = path.at(np.linspace(0.0, path.length, 200))[0]
        step, done = 1.0 / self.camera.settings.rate_Hz, 0
        for t in np.arange(trace.t_s[0], trace.t_s[-1] + 1e-9, step).tolist():
            k = min(int(np.searchsorted(trace.t_s, t - 1e-9)), len(trace) - 1)
            picture = self._picture(t, trace.q_rad[k])
            # Only the next 20 points are searched, because a path may cross itself.
            away = np.linalg.norm(line[done : done + 20] - trace.tip_ref_m[k], axis=1)
            done += int(np.argmin(away)) if away.min() < _ON_PATH_M else 0
            markers = len(self._finder.corners(picture))
            text = f"{t:.2f} s   " + (f"{markers} markers" if markers else "board lost")
            share = done / (len(line) - 1)
            yield draw(picture, self.believed, task=line, progress=share, tip=trace.tip_m[k], trocar=trocar, text=text)

    def _picture(self, t: float, q: ArrayLike | None) -> Picture:
        pose = None if q is None else np.array(q, dtype=np.float64)
        return self._view.picture(None if self.board.is_lost(t) else self.phantom, self._hidden, pose)

    def _look(self, t: float, q: ArrayLike | None) -> Tracked:
        sighting = self._finder.find(self._picture(t, q))
        if sighting is not None:
            sighting = replace(sighting, pose=self.believed.camera_in_base @ sighting.pose)
        return self._tracker.update(t, sighting)


def draw(
    picture: Picture, camera: Camera, *, task: ArrayLike, progress: float, tip: ArrayLike, trocar: ArrayLike, text: str
) -> Picture:
    """Draw task (k, 3), tip (3,) and trocar (3,), in the base frame [m], into a copy of the picture (H, W, 3).

    ``progress`` is the finished share of the path (0 to 1).
    """
    page = picture.copy()
    points, end, far = (np.asarray(part, dtype=np.float64) for part in (task, tip, trocar))
    done = round(min(max(progress, 0.0), 1.0) * (len(points) - 1))
    for part, colour in ((points[done:], TASK), (points[: done + 1], DONE)):
        pixels = camera.project(part)
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        if len(pixels) > 1:
            sixteenths = np.rint(16.0 * np.clip(pixels, -1e5, 1e5)).astype(np.int32)
            cv2.polylines(page, [sixteenths], False, colour, 2, cv2.LINE_AA, 4)
    near, away = camera.camera_in_base.inverse().apply(np.array([end, far]))[:, 2]
    if near > _NEAR_M:
        if away < _NEAR_M:  # the trocar is behind the camera
            far = end + (near - _NEAR_M) / (near - away) * (far - end)
        pixel, beyond = np.clip(camera.project(np.array([end, far])), -1e6, 1e6)
        _line_to_trocar(page, _whole(pixel), _whole(beyond))
        if np.abs(pixel).max() < 1e4:
            cv2.drawMarker(page, _whole(pixel), TIP, cv2.MARKER_CROSS, 16, 2, cv2.LINE_AA)
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    x, y = 6, page.shape[0] - 8
    cv2.rectangle(page, (x - 4, y - height - 4), (x + width + 4, y + below + 2), (40, 40, 40), cv2.FILLED)
    cv2.putText(page, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, TEXT, 1, cv2.LINE_AA)
    return page


def _line_to_trocar(page: Picture, start: tuple[int, int], end: tuple[int, int]) -> None:
    height, width = page.shape[:2]
    inside, first, last = cv2.clipLine((0, 0, width, height), start, end)
    if inside:
        cv2.line(page, first, last, TROCAR, 1, cv2.LINE_AA)
        label = (min(max(last[0] + 6, 0), width - 60), min(max(last[1], 16), height - 8))
        cv2.putText(page, "trocar", label, cv2.FONT_HERSHEY_SIMPLEX, 0.45, TROCAR, 1, cv2.LINE_AA)


def _whole(pixel: Array) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def save_film(path: str | os.PathLike[str], pictures: Iterable[Picture], rate_Hz: float) -> int:
    """Write pictures (H, W, 3) to a film (.webm); return their count. Raise a PlantError if this fails."""
    writer, count = cv2.VideoWriter(), 0
    for picture in pictures:
        if not count:
            writer.open(str(path), cv2.VideoWriter.fourcc(*_CODEC), rate_Hz, picture.shape[1::-1])
        if not writer.isOpened():
            raise PlantError(f"film {str(path)!r} cannot be written: check its folder, rights and space")
        writer.write(picture)
        count += 1
    writer.release()
    return count
