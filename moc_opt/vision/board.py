"""Poses, a marker board, and virtual tasks.

The origin of a board's frame is its middle. Seen from the printed side, x points right, y up, and z towards the viewer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from moc_opt.arrays import Array, read_only
from moc_opt.errors import MocOptError, PlantError, TaskError, UnknownNameError
from moc_opt.inputs.settings import Settings
from moc_opt.tasks import Path, make_path
from moc_opt.tasks.checks import direction3


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid pose of an inner frame in an outer one: x_outer = R x_inner + t.

    Poses are chained with @: board_in_base = camera_in_base @ board_in_camera.
    """

    R: Array  #: (3, 3) rotation
    t: Array  #: (3,) inner origin in the outer frame [m]

    def __init__(self, R: ArrayLike, t: ArrayLike) -> None:
        object.__setattr__(self, "R", read_only(np.array(R, dtype=np.float64)))
        object.__setattr__(self, "t", read_only(np.array(t, dtype=np.float64)))

    def apply(self, points: ArrayLike) -> Array:
        """Transform points (3,) or (k, 3) [m] from the inner to the outer frame."""
        return self.turn(points) + self.t

    def turn(self, vectors: ArrayLike) -> Array:
        """Transform directions (3,) or (k, 3) from the inner to the outer frame."""
        return np.asarray(np.asarray(vectors, dtype=np.float64) @ self.R.T)

    def inverse(self) -> Pose:
        """Return the pose of the outer frame in the inner one."""
        return Pose(self.R.T, -self.R.T @ self.t)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.R @ other.R, self.apply(other.t))

    def distance(self, other: Pose) -> tuple[float, float]:
        """Return the distance [m] and angle [rad] to another pose."""
        return float(np.linalg.norm(self.t - other.t)), float(np.linalg.norm(pin.log3(self.R.T @ other.R)))

    def towards(self, other: Pose, share: float) -> Pose:
        """Interpolate from this pose (``share`` 0) to the other pose (1)."""
        turn = rotation_from(share * pin.log3(self.R.T @ other.R))
        return Pose(self.R @ turn, self.t + share * (other.t - self.t))


def rotation_from(vector: ArrayLike) -> Array:
    """Return the rotation (3, 3) of a rotation vector (3,) [rad]."""
    return np.asarray(pin.exp3(np.array(vector, dtype=np.float64)))


class VisionSettings(Settings):
    """Base class of the settings in this package. A value out of range raises a PlantError."""

    ERROR: ClassVar[type[MocOptError]] = PlantError


class Board(VisionSettings):
    """A grid of square markers on the phantom (a dummy patient). Markers are numbered row by row from the top left."""

    KIND: ClassVar[str] = "[board]"

    columns: int = Field(5, ge=1, le=20)
    rows: int = Field(4, ge=1, le=20)
    marker_m: float = Field(0.020, gt=0.0, le=0.5, description="side of a marker")
    gap_m: float = Field(0.005, gt=0.0, le=0.5, description="white space between markers, and around them")
    hidden_fraction: float = Field(0.0, ge=0.0, le=1.0, description="share of the markers that are covered")
    lost_s: tuple[tuple[float, float], ...] = ()
    """time intervals [from, until] in seconds, in which the board is out of sight"""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for start, end in self.lost_s:
            if not 0.0 <= start < end:
                raise ValueError(f"lost_s = {[start, end]}: give [from, until] with 0 <= from < until")
        if self.columns * self.rows > 250:
            raise ValueError(f"columns x rows = {self.columns * self.rows}: give at most 250 markers")
        return self

    def is_lost(self, t: float) -> bool:
        """Return whether the board is out of sight at t [s]."""
        return any(start <= t < end for start, end in self.lost_s)

    @property
    def ids(self) -> range:
        """Numbers of the markers in OpenCV's dictionary."""
        return range(self.columns * self.rows)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the board."""
        pitch = self.marker_m + self.gap_m
        return self.columns * pitch + self.gap_m, self.rows * pitch + self.gap_m

    def corners(self, marker: int) -> Array:
        """Return a marker's corners (4, 3) in the board's frame [m], clockwise from the top left."""
        row, column = divmod(marker, self.columns)
        pitch, (left, top, _) = self.marker_m + self.gap_m, self.outline()[0]
        left, top = left + self.gap_m + column * pitch, top - self.gap_m - row * pitch
        return _rectangle(left, top, left + self.marker_m, top - self.marker_m)

    def outline(self) -> Array:
        """Return the board's corners (4, 3) in its own frame [m], clockwise from the top left."""
        x, y = 0.5 * self.size_m[0], 0.5 * self.size_m[1]
        return _rectangle(-x, y, x, -y)

    def task_in_base(self, task: BoardTask, board_in_base: Pose) -> Path:
        """Transform a virtual task into the base frame. Raise a TaskError if it reaches beyond the board."""
        own = task.on_board()
        places = own.at(np.linspace(0.0, own.length, 65))[0]
        beyond = float((np.abs(places[:, :2]) - 0.5 * np.array(self.size_m)).max())
        if beyond > 0.0:
            raise TaskError(
                f"task {task.kind!r} reaches {1e3 * beyond:.1f} mm beyond its board of "
                f"{1e3 * self.size_m[0]:.0f} x {1e3 * self.size_m[1]:.0f} mm: make its sizes smaller or move start_m"
            )
        return make_path(
            task.kind, board_in_base.apply(own.start), normal=board_in_base.turn(own.normal),
            heading=board_in_base.turn(own.heading), **task.sizes,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class BoardTask:
    """A virtual task: a path parallel to a board."""

    kind: str  #: kind of path; see `make_path`
    sizes: Mapping[str, float]  #: sizes of the path, lengths in m
    start_m: tuple[float, float] = (0.0, 0.0)  #: start of the path, x and y in the board's frame
    height_m: float = 0.005  #: height of the path above the board
    depth_m: float = 0.15  #: depth of the board below the trocar

    def on_board(self) -> Path:
        """Return the path in the board's frame."""
        start = (*self.start_m, self.height_m)
        return make_path(self.kind, start, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), **self.sizes)


def _rectangle(left: float, top: float, right: float, bottom: float) -> Array:
    return np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])


_WAVES = {"amplitude": 0.01, "wavelength": 0.02, "periods": 2.0}
BOARD_TASKS: Mapping[str, BoardTask] = MappingProxyType({
    "circle": BoardTask("circle", {"radius": 0.02}, start_m=(0.0, -0.02), depth_m=0.15),
    "sinusoid": BoardTask("sinusoid", _WAVES, start_m=(-0.02, 0.0), depth_m=0.12),
    "spiral": BoardTask("spiral", {"turns": 2.0, "radius": 0.015}, depth_m=0.20),
})  # fmt: skip
"""The three virtual tasks."""


def board_task(name: str) -> BoardTask:
    """Return one of `BOARD_TASKS`, or raise an UnknownNameError."""
    if name not in BOARD_TASKS:
        raise UnknownNameError("virtual task", str(name), BOARD_TASKS)
    return BOARD_TASKS[name]


def board_below(trocar: ArrayLike, shaft: ArrayLike, depth_m: float) -> Pose:
    """Return the pose of a board that faces the trocar, ``depth_m`` from the trocar along the shaft.

    ``shaft`` (3,) is the direction from the trocar into the body. The board's x is the base's x, projected on the
    board, and its z points to the trocar. A TaskError is raised if the shaft is parallel to the base's x.
    """
    into = direction3("shaft", shaft)
    x = direction3("shaft", np.array([1.0, 0.0, 0.0]) - into[0] * into)
    return Pose(np.stack([x, np.cross(-into, x), -into], axis=1), np.asarray(trocar) + depth_m * into)
