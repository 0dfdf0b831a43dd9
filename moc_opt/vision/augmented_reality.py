"""The augmented reality put together: camera, board, detection and tracking, and the tasks carried to the robot."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import TaskError
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.tasks import Path
from moc_opt.trace.trace import Trace
from moc_opt.vision.board import BoardTask
from moc_opt.vision.camera import Camera, Picture, Scene, hide
from moc_opt.vision.image_source import make_view
from moc_opt.vision.markers import BoardFinder
from moc_opt.vision.overlay import Overlay, save_video
from moc_opt.vision.pinhole import DrawnView
from moc_opt.vision.pose import Pose
from moc_opt.vision.settings import BoardSettings, CameraSettings, TrackerSettings
from moc_opt.vision.tracking import BoardTracker, Sighting, Tracked

Poses = Callable[[float], "Array | None"]

_SEARCH_S = 2.0
_ON_PATH_M = 0.001


@dataclass(frozen=True, eq=False, repr=False)
class Look:
    """One picture and its evaluation."""

    picture: Picture
    sighting: Sighting | None
    """the board in the camera's frame, from this picture alone"""
    tracked: Tracked
    """the board in the base frame, from all pictures so far"""


@dataclass(frozen=True, eq=False, repr=False)
class Watch:
    """The camera's answers during a run; one entry a picture."""

    t_s: Array
    """(k,) [s]"""
    seen: NDArray[np.bool_]
    """(k,) whether the board was tracked"""
    boards: tuple[Pose, ...]
    """the tracked board in the base frame; the last one while it is lost"""


class Augmented:
    """An endoscope that looks at a phantom's board, and the evaluation of its pictures.

    Attributes: `camera` where it truly is, `believed` where calibration puts it, `board`, `view`, and `source`:
        "mujoco" or "drawn", with the reason in `why` if MuJoCo was asked for by "auto" and could not be used.
    """

    def __init__(
        self, robot: RobotModel, phantom_in_base: Pose, *, camera: CameraSettings | None = None,
        board: BoardSettings | None = None, tracker: TrackerSettings | None = None, seed: int = 0,
    ) -> None:  # fmt: skip
        """Set everything up.

        Args:
            robot: for the tool in the picture.
            phantom_in_base: true pose of the phantom's board, around which the camera is placed.
            seed: of noise, calibration error and of which markers are hidden.

        Raises:
            PlantError: MuJoCo's renderer was asked for and cannot be used here.
        """
        self.settings = BoardSettings() if board is None else board
        self.board = self.settings.board()
        self.phantom = phantom_in_base
        noise, calibration, hidden = np.random.SeedSequence(seed).generate_state(3).tolist()
        self.camera = Camera.above(CameraSettings() if camera is None else camera, phantom_in_base)
        self.believed = self.camera.miscalibrated(calibration)
        self.hidden = hide(self.board.ids, self.settings.hidden_fraction, hidden)
        self.view, self.why = make_view(robot, self.camera, self.board, seed=noise)
        self.source = "drawn" if isinstance(self.view, DrawnView) else "mujoco"
        self._finder = BoardFinder(self.board, self.believed)
        self._tracker = BoardTracker(tracker)

    def look(self, t: float, q: ArrayLike | None = None, *, board_in_base: Pose | None = None) -> Look:
        """Take a picture, find the board in it, and tell the tracker.

        Args:
            t: time [s], later than the last picture's; decides whether the board is lost.
            q: (n,) pose of the arm, whose tool may be in the way; None: no arm.
            board_in_base: where the board truly is; None: where the phantom was at the beginning.

        Raises:
            TaskError: t does not rise.
        """
        scene = Scene(
            self.phantom if board_in_base is None else board_in_base, self.hidden, self.settings.is_lost(t),
            None if q is None else np.asarray(q, dtype=np.float64),
        )  # fmt: skip
        picture = self.view.picture(scene)
        sighting = self._finder.find(picture)
        in_base = None
        if sighting is not None:
            pose = self.believed.camera_in_base @ sighting.pose
            in_base = Sighting(pose, sighting.markers, sighting.error_px)
        return Look(picture, sighting, self._tracker.update(t, in_base))

    def locate(self, q: ArrayLike | None = None, *, seconds: float = 1.0) -> Pose:
        """Search for the board anew, before t = 0 and before anything moves.

        Args:
            q: (n,) pose of the arm, at rest.
            seconds: how long the board is looked at, once it has been found [s].

        Returns:
            The board in the base frame, averaged over the pictures.

        Raises:
            TaskError: it was not found within 2 s; says what was seen and what to change.
        """
        self._tracker = BoardTracker(self._tracker.limits)
        rate = self.camera.settings.rate_Hz
        count, wanted = round((_SEARCH_S + seconds) * rate) + 1, math.ceil(seconds * rate)
        refused: Counter[str] = Counter()
        found: list[Pose] = []
        for k in range(count):
            tracked = self.look((k - count) / rate, q).tracked
            refused.update([] if tracked.refused is None else [tracked.refused])
            if tracked.seen and tracked.pose is not None:
                found.append(tracked.pose)
                if len(found) > wanted:
                    break
        if not found:
            reasons = "; ".join(f"{reason} ({times} pictures)" for reason, times in refused.most_common(3))
            raise TaskError(
                f"board: never seen in {count} pictures: {reasons}. Uncover it (hidden_fraction = "
                f"{self.settings.hidden_fraction:g}), point the camera at it (distance_m, tilt_deg, fov_deg), or "
                "lower min_markers"
            )
        return found[-1]

    def watch(
        self, seconds: float, q: Poses | None = None, board_in_base: Callable[[float], Pose] | None = None
    ) -> Watch:
        """Look at the board for a whole run.

        Args:
            seconds: length of the run, from t = 0 [s].
            q: time [s] -> pose (n,) of the arm; None: no arm in the picture.
            board_in_base: time [s] -> true pose of the board; None: it rests.

        Raises:
            TaskError: the board was not found before (call `locate` first).
        """
        rate = self.camera.settings.rate_Hz
        times = np.arange(math.floor(seconds * rate) + 1) / rate
        seen, boards = [], []
        for t in times.tolist():
            pose = None if q is None else q(t)
            tracked = self.look(t, pose, board_in_base=None if board_in_base is None else board_in_base(t)).tracked
            if tracked.pose is None:
                raise TaskError("board: it was not found before the run: call locate() before watch()")
            seen.append(tracked.seen)
            boards.append(tracked.pose)
        return Watch(times, np.array(seen), tuple(boards))

    def task(self, task: BoardTask | str, board_in_base: Pose) -> Path:
        """Carry a virtual task into the base frame, for a board at this (estimated) pose; see `Board.task_in_base`."""
        return self.board.task_in_base(task, board_in_base)

    def accuracy(self, estimate: Pose, task: BoardTask | str | None = None) -> dict[str, float]:
        """Measure how far an estimate of the board in the base frame is from the truth, calibration error included.

        Returns:
            board_position_mm, board_angle_deg, and with a task: task_error_max_mm, the largest distance between
            a point of the task where it should be and where the robot takes it to be.
        """
        way, turn = estimate.distance(self.phantom)
        found = {"board_position_mm": 1e3 * way, "board_angle_deg": math.degrees(turn)}
        if task is not None:
            true, believed = (self.task(task, pose) for pose in (self.phantom, estimate))
            s = np.linspace(0.0, true.length, 200)
            off = np.linalg.norm(true.at(s)[0] - believed.at(np.minimum(s, believed.length))[0], axis=1)
            found["task_error_max_mm"] = 1e3 * float(off.max())
        return found

    def film(self, file: str | os.PathLike[str], trace: Trace, path: Path, trocar: ArrayLike) -> int:
        """Film the run as the surgeon sees it, one picture for each of the camera's.

        Args:
            file: .webm, .mp4 or .avi, or a folder for numbered PNG.
            trace: the run, with t_s, q_rad, tip_m and tip_ref_m.
            trocar: (3,) as registered, base frame [m].

        Returns:
            The number of pictures.

        Raises:
            PlantError: the film cannot be written.
        """
        return save_video(
            file, self._frames(trace, path, np.asarray(trocar, dtype=np.float64)), self.camera.settings.rate_Hz
        )

    def _frames(self, trace: Trace, path: Path, trocar: Array) -> Iterator[Picture]:
        overlay = Overlay(self.believed)
        line = path.at(np.linspace(0.0, path.length, 200))[0]
        step, done = 1.0 / self.camera.settings.rate_Hz, 0
        for t in np.arange(trace.t_s[0], trace.t_s[-1] + 1e-9, step).tolist():
            k = min(int(np.searchsorted(trace.t_s, t - 1e-9)), len(trace) - 1)
            scene = Scene(self.phantom, self.hidden, self.settings.is_lost(t), np.array(trace.q_rad[k]))
            picture = self.view.picture(scene)
            # A path may meet itself: look a little ahead only, and only once the reference is on it.
            away = np.linalg.norm(line[done : done + 20] - trace.tip_ref_m[k], axis=1)
            done += int(np.argmin(away)) if away.min() < _ON_PATH_M else 0
            markers = len(self._finder.corners(picture))
            text = f"{t:.2f} s   " + (f"{markers} markers" if markers else "board lost")
            share = done / (len(line) - 1)
            yield overlay.draw(picture, task=line, progress=share, tip=trace.tip_m[k], trocar=trocar, text=text)
