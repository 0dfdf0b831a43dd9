"""Runs in 3-D, in one HTML file that opens by itself: ``Replay({"exact": trace}, robot).save("replay.html")``.

The arm moves in a small WebGL viewer, its curves move along, nothing is fetched. The arm is drawn from its joint
frames alone: every part is a body of revolution on one link. No mesh file is needed, so that any robot that can be
loaded can be shown; what is drawn has the arm's lengths and axes, and its thickness is made up, in proportion to its
reach.
"""

from __future__ import annotations

import base64
import gzip
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import ReportError
from moc_opt.figures.series import PANELS, envelope
from moc_opt.figures.style import DARK, Styles
from moc_opt.planning.swivel_map import check_showable as check
from moc_opt.report.document import render, save_document
from moc_opt.robots.chain import link_frames
from moc_opt.robots.model import RobotModel, load_robot, restored
from moc_opt.trace.trace import Trace

MOST_RUNS = 4
FRAMES_PER_S = 30.0
FRAMES_IN_ALL = 9000
"""Of all runs together; a longer replay gets fewer per second, and the page moves evenly between them."""
PATH_POINTS = 1500
SERIES_POINTS = 900
Profile = list[tuple[float, float]]
"""(radius, height) [m], from below to above"""

BASE = -1
SHORTEST_M = 1e-3
ACROSS = 0.7
"""Cosine between a joint's axis and its link, below which the joint looks like an elbow, above like a ring."""


class Replay:
    """One to four runs of one arm, side by side at the same time.

    The file needs a browser of 2023 or later, no server and no network. Append ``#t=3.2`` to its address to
    open it at that second.
    """

    def __init__(
        self, traces: Mapping[str, Trace], robot: RobotModel, *, title: str = "", styles: Styles | None = None
    ) -> None:
        """Check the runs.

        Args:
            traces: name -> run, in the order in which they are shown.
            robot: their arm; `robot_of` finds it from a trace.
            title: of the page; from the names if empty.
            styles: of each run, as in a report's figures; None assigns colours anew.

        Raises:
            ReportError: no runs, too many, or one that cannot be shown with this arm.
        """
        if not 1 <= len(traces) <= MOST_RUNS:
            raise ReportError(f"{len(traces)} runs: give 1 to {MOST_RUNS}, more are too small to see")
        for name, trace in traces.items():
            check(name, trace, robot)
        self.traces, self.robot = MappingProxyType(dict(traces)), robot
        self.title = title or " and ".join(traces)
        self._styles = styles or Styles(traces)

    @classmethod
    def load(cls, files: Sequence[str | os.PathLike[str]]) -> Self:
        """Load a replay of saved traces, named as their files are.

        Raises:
            ReportError: they are not of one robot and tool, or cannot be shown.
            TraceError: a file is missing, damaged, or no trace.
        """
        traces, robot = load_runs(files)
        return cls(traces, robot)

    def data(self) -> tuple[dict[str, Any], str]:
        """Return what the page shows: a JSON value, and the block of numbers it points into."""
        block, times = Block(), frame_times(self.traces)
        runs = []
        for name, trace in self.traces.items():
            color = self._styles[name].color
            track = run_track(name, trace, self.robot, times, block)
            runs.append({**track, "color": {"light": color, "dark": DARK.get(color, color)}})
        panels = [{"title": PANELS[column][0], "zero": column != "mu"} for column in PANELS]
        value = {
            "times": block.put(times), "runs": runs, "panels": panels,
            "parts": [part.plain() for part in arm_parts(self.robot)],
            "reach": float(np.linalg.norm(self.robot.chain.origins, axis=1).sum() + self.robot.data.tool_length),
        }  # fmt: skip
        return value, block.packed()

    def html(self) -> str:
        """Return the whole file as text."""
        value, packed = self.data()
        robot = self.robot.data
        return render(
            "replay.html", title=self.title, subtitle=f"{robot.name}, tool of {robot.tool_length:.2f} m",
            bound=", ".join(dict.fromkeys(
                str(trace.meta["mu_bound_method"]) for trace in self.traces.values() if "mu_bound_method" in trace.meta
            )),
            value=json.dumps(value, allow_nan=False, separators=(",", ":")), numbers=packed,
        )  # fmt: skip

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the file, all or nothing: an older one of that name stays until the new one is there.

        Raises:
            ReportError: it would be larger than `document.MAX_BYTES`, or cannot be written.
        """
        return save_document(
            path, self.html(), "replay", lambda: "show fewer runs, or a part of them (`trace.select`)"
        )


# --- saved runs, and their arm ---


def load_runs(files: Sequence[str | os.PathLike[str]]) -> tuple[dict[str, Trace], RobotModel]:
    """Load saved traces under the names of their files, and the arm that they share.

    Raises:
        ReportError: there are none, or they are not of one robot and tool.
        TraceError: a file is missing, damaged, or no trace.
    """
    traces: dict[str, Trace] = {}
    for file in map(Path, files):
        name = file.stem if file.stem not in traces else str(file)
        traces[name] = Trace.load(file)
    arms = {name: _robot_table(trace) for name, trace in traces.items()}
    if not traces or len(set(map(str, arms.values()))) > 1:
        raise ReportError(f"traces of {arms or 'nothing'}: give traces of one robot with one tool")
    return traces, robot_of(next(iter(traces.values())))


def robot_of(trace: Trace) -> RobotModel:
    """Load the arm that a trace was run with: the one that its `meta` carries, or the one of the package it names.

    Raises:
        ReportError: the trace does not say.
        RobotError, UnknownNameError: that robot cannot be loaded here.
    """
    if "robot_data" in trace.meta:
        return restored(trace.meta["robot_data"])
    table = _robot_table(trace)
    if not table.get("name"):
        raise ReportError("the trace does not say which robot it is of: load it yourself with load_robot")
    return load_robot(table["name"], tool_length=table.get("tool_length_m"), tool_mass=table.get("tool_mass_kg"))


def _robot_table(trace: Trace) -> dict[str, Any]:
    table = dict((trace.meta.get("scenario") or {}).get("robot") or {})
    return {**table, "name": table.get("name") or trace.meta.get("robot")}


# --- what moves: poses, points and curves of every run, thinned, as one block of numbers ---


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
    course = np.unique(np.linspace(0, len(t) - 1, min(len(t), PATH_POINTS)).round().astype(int))
    arrays = {
        "poses": poses.reshape(len(times), robot.n, 12), "tip": trace.tip_m[ticks], "asked": trace.tip_ref_m[ticks],
        "ellipsoid": velocity_ellipsoids(np.array([robot.state(q).J_tip for q in trace.q_rad[ticks]])),
        "course_t": t[course], "course": trace.tip_m[course], "course_asked": trace.tip_ref_m[course],
        **({"trocar": trace.trocar_m[ticks]} if "trocar_m" in trace.columns else {}),
    }  # fmt: skip
    return {
        "name": name, "end": float(t[-1]), "ended": str(trace.meta.get("ended", "completed")),
        **{key: block.put(array) for key, array in arrays.items()},
        "panels": [_panel(trace, column, ticks, block) for column in PANELS],
    }  # fmt: skip


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


# --- what it looks like ---


class Part(NamedTuple):
    """A profile turned about an axis.

    Attributes:
        link: joint whose frame it rides on, from 0; `BASE` stands still.
        origin: (3,) where height 0 is, in that frame [m]; axis: (3,) unit vector.
        radii, heights: (k,) the profile's points, from below to above [m].
        role: "shell", "joint" or "tool", which gives its colour.
    """

    link: int
    origin: Array
    axis: Array
    radii: Array
    heights: Array
    role: str

    def plain(self) -> dict[str, Any]:
        """Return it as JSON, in micrometres' resolution."""
        return {name: value if isinstance(value, int | str) else np.round(value, 6).tolist()
                for name, value in self._asdict().items()}  # fmt: skip


def arm_parts(robot: RobotModel) -> list[Part]:
    """Build the parts of an arm and its tool."""
    chain, n = robot.chain, robot.n
    tip, wrist = chain.offsets
    along = (tip - wrist) / np.linalg.norm(tip - wrist)
    mount = tip - robot.data.tool_length * along
    ends = [*chain.origins, mount]  # of the piece that begins at the frame before
    reach = float(sum(np.linalg.norm(end) for end in chain.origins))
    radius = np.linspace(0.058, 0.038, n + 1) * reach
    parts = [_turned(BASE, np.zeros(3), np.array([0.0, 0.0, 1.0]), [
        (0.0, 0.0), (1.9 * radius[0], 0.0), (1.9 * radius[0], 0.012 * reach), (1.25 * radius[0], 0.03 * reach),
        (0.0, 0.03 * reach),
    ], "shell")]  # fmt: skip
    lengths = [float(np.linalg.norm(end)) for end in ends]
    last = max(k for k, length in enumerate(lengths) if length > SHORTEST_M)
    for link, end in enumerate(ends, start=BASE):
        length = lengths[link + 1]
        if length > SHORTEST_M:
            shape = _capsule(radius[max(link, 0)], radius[min(link + 1, n - 1)], length, link + 1 < last)
            if link == BASE:
                shape = [(shape[7][0], 0.0), *shape[8:]]  # it stands on the ground
            parts.append(_turned(link, np.zeros(3), end / length, shape, "shell"))
    for j in range(n):
        axis = chain.axes[j]
        # The longer neighbour tells the joint's kind: wrists have links of no length.
        beside = max(ends[j + 1], chain.rotations[j].T @ ends[j], key=lambda end: float(np.linalg.norm(end)))
        length = float(np.linalg.norm(beside))
        across = length > SHORTEST_M and abs(float(axis @ beside)) / length < ACROSS
        r = radius[j]
        if across:
            width = 1.12 * r
            parts.append(_turned(j, np.zeros(3), axis, _drum(1.06 * r, width), "shell"))
            for side in (-1.0, 1.0):
                parts.append(_turned(j, side * width * axis, side * axis, _cap(0.78 * r, 0.10 * r), "joint"))
        else:
            parts.append(_turned(j, np.zeros(3), axis, _drum(1.04 * r, 0.10 * r), "joint"))
    thin = 0.004
    tool = [(0.0, 0.0), (5 * thin, 0.0), (5 * thin, 0.012), (2 * thin, 0.03), (thin, 0.032)]
    length = robot.data.tool_length
    tool = [(r, min(h, 0.5 * length)) for r, h in tool]
    tool += [(thin, length - 0.008), (0.75 * thin, length - 0.003), (0.0, length)]
    parts.append(_turned(n - 1, mount, along, tool, "tool"))
    return parts


def _turned(link: int, origin: Array, axis: Array, profile: Profile, role: str) -> Part:
    radii, heights = np.array(profile).T
    return Part(link, origin, axis, radii, heights, role)


def _capsule(below: float, above: float, length: float, closed: bool) -> Profile:
    """Return a cone from one ball to the next; flat at the flange, where the tool begins."""
    bend = np.linspace(-0.5 * np.pi, 0.0, 8)
    start = [(below * np.cos(a), below * np.sin(a)) for a in bend]
    if closed:
        return start + [(above * np.cos(a), length + above * np.sin(a)) for a in -bend[::-1]]
    return [*start, (above, length), (0.0, length)]


def _drum(radius: float, half: float) -> Profile:
    """Return a cylinder about its middle, its edges broken."""
    edge = 0.15 * min(radius, half)
    side = [(radius - edge, half), (radius, half - edge)]
    return [(0.0, -half), *((r, -h) for r, h in side), *reversed(side), (0.0, half)]


def _cap(radius: float, height: float) -> Profile:
    return [(radius, 0.0), (radius, 0.6 * height), (0.85 * radius, height), (0.0, height)]
