"""The moving parts of a replay, thinned and packed: poses, points and curves of every run as one block of numbers."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.figures.series import PANELS, envelope
from moc_opt.model.frames import link_frames
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.trace.trace import Trace

FRAMES_PER_S = 30.0
FRAMES_IN_ALL = 9000
"""Of all runs together; a longer replay gets fewer per second, and the page moves evenly between them."""
PATH_POINTS = 1500
SERIES_POINTS = 900


class Block:
    """Arrays one after another in single precision; `put` says where one lies."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.float32]] = []
        self._size = 0

    def put(self, array: Array) -> list[int]:
        """Append an array: [first number, shape...]."""
        part = np.ascontiguousarray(array, dtype=np.float32)
        place = [self._size, *part.shape]
        self._parts.append(part.ravel())
        self._size += part.size
        return place

    def packed(self) -> str:
        """Return little-endian, compressed, base64."""
        raw = np.concatenate(self._parts).astype("<f4").tobytes() if self._parts else b""
        return base64.b64encode(gzip.compress(raw, mtime=0)).decode()


def frame_times(runs: Mapping[str, Trace]) -> Array:
    """Return times [s] of the frames, the same for all runs: from the first tick of any to the last of any."""
    start = min(float(trace.t_s[0]) for trace in runs.values())
    end = max(float(trace.t_s[-1]) for trace in runs.values())
    count = int(np.ceil((end - start) * FRAMES_PER_S)) + 1
    return np.linspace(start, end, max(2, min(count, FRAMES_IN_ALL // len(runs))))


def run_track(name: str, trace: Trace, robot: RobotModel, times: Array, block: Block) -> dict[str, Any]:
    """Pack one run; a run that ends early stands still afterwards."""
    t = trace.t_s
    ticks = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 1)
    origins, rotations = link_frames(robot.chain, trace.q_rad[ticks])
    poses = np.concatenate([rotations, origins[..., None]], axis=3)  # (k, n, 3, 4)
    states = [robot.state(q) for q in trace.q_rad[ticks]]
    course = np.unique(np.linspace(0, len(t) - 1, min(len(t), PATH_POINTS)).round().astype(int))
    track = {
        "name": name,
        "end": float(t[-1]),
        "ended": str(trace.meta.get("ended", "completed")),
        "poses": block.put(poses.reshape(len(times), robot.n, 12)),
        "tip": block.put(trace.tip_m[ticks]),
        "asked": block.put(trace.tip_ref_m[ticks]),
        "ellipsoid": block.put(velocity_ellipsoids(np.array([state.J_tip for state in states]))),
        "course_t": block.put(t[course]),
        "course": block.put(trace.tip_m[course]),
        "course_asked": block.put(trace.tip_ref_m[course]),
        "panels": [_panel(trace, column, ticks, block) for column in PANELS],
    }
    if "trocar_m" in trace.columns:
        track["trocar"] = block.put(trace.trocar_m[ticks])
    return track


def velocity_ellipsoids(jacobians: Array) -> Array:
    """Return (k, 3, 3) the symmetric S = (J J^T)^(1/2) that takes the unit sphere to the ellipsoid of tip velocities.

    Its half axes are the singular values of J, its determinant is mu (Yoshikawa 1985), and between two frames
    it changes evenly, as eigenvectors do not.

    Args:
        jacobians: J_T (k, 3, n).
    """
    squares = jacobians @ np.swapaxes(jacobians, 1, 2)
    values, vectors = np.linalg.eigh(squares)
    lengths = np.sqrt(np.maximum(values, 0.0))
    roots: Array = (vectors * lengths[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return roots


def _panel(trace: Trace, column: str, ticks: NDArray[np.intp], block: Block) -> dict[str, Any] | None:
    """Return one quantity of one run: its curve, its value at every frame, and mu's bound; None where it has none."""
    if column not in trace.columns:
        return None
    values = trace.columns[column].astype(np.float64)
    if values.ndim == 2:
        values = np.linalg.norm(values, axis=1)
    values = PANELS[column][1] * values
    t, y = envelope(trace.t_s, values, SERIES_POINTS)
    panel = {"t": block.put(t), "y": block.put(y), "at": block.put(values[ticks])}
    if column == "mu" and "mu_bound" in trace.columns:
        known = np.isfinite(trace.mu_bound)
        if known.any():
            panel |= {"bound_t": block.put(trace.t_s[known]), "bound": block.put(trace.mu_bound[known])}
    return panel
