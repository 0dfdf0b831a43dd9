"""Show runs in 3-D, in one HTML file."""

from __future__ import annotations

import base64
import gzip
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import ReportError
from moc_opt.figures.series import PANELS, envelope
from moc_opt.figures.style import DARK, Styles
from moc_opt.inputs.files import to_json
from moc_opt.planning.swivel_map import check_showable
from moc_opt.report.document import render, save_document
from moc_opt.report.run_table import listed, title_of
from moc_opt.robots.model import RobotModel, link_frames, load_robot, restored
from moc_opt.trace.trace import Trace, table

MOST_RUNS = 4
FRAMES_PER_S = 30.0
FRAMES_IN_ALL = 9000
PATH_POINTS = 1500
SERIES_POINTS = 900

BASE = -1
SHORTEST_M = 1e-3
ACROSS = 0.7
"""A joint is drawn as an elbow if |cos(angle between its axis and its link)| is below this."""


class Replay:
    """One to four runs of one arm, played side by side."""

    def __init__(self, traces: Mapping[str, Trace], robot: RobotModel) -> None:
        """Raise a ReportError if the number of runs is wrong, or `check_showable` refuses one."""
        if not 1 <= len(traces) <= MOST_RUNS:
            raise ReportError(f"{len(traces)} runs: give 1 to {MOST_RUNS}; more are too small to see")
        for name, trace in traces.items():
            check_showable(name, trace, robot)
        self.traces, self.robot = dict(traces), robot

    def data(self) -> dict[str, Any]:
        """Return the names, texts and arrays of the page."""
        start = min(float(trace.t_s[0]) for trace in self.traces.values())
        end = max(float(trace.t_s[-1]) for trace in self.traces.values())
        frames = min(int(np.ceil((end - start) * FRAMES_PER_S)) + 1, FRAMES_IN_ALL // len(self.traces))
        times = np.linspace(start, end, max(2, frames))
        lengths, styles = np.linalg.norm(self.robot.chain.origins, axis=1), Styles(self.traces)
        return {
            "times": times, "parts": [part._asdict() for part in arm_parts(self.robot)],
            "runs": [
                {"name": name, **_run_data(trace, self.robot, times, styles[name].color)}
                for name, trace in self.traces.items()
            ],
            "panels": [{"title": title, "zero": column != "mu"} for column, (title, _) in PANELS.items()],
            "reach": float(lengths.sum() + self.robot.data.tool_length),
        }  # fmt: skip

    def html(self) -> str:
        """Return the whole file as text."""
        bounds = [trace.meta.get("mu_bound_method", "") for trace in self.traces.values()]
        packed = gzip.compress(to_json(_rounded(self.data()), indent=None).encode(), mtime=0)
        return render(
            "replay.html", title=title_of(self.traces), bound=listed(filter(None, bounds)),
            subtitle=f"tool of {self.robot.data.tool_length:.2f} m", packed=base64.b64encode(packed).decode(),
        )  # fmt: skip

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the file, as `save_document` does."""
        return save_document(path, self.html(), "replay", force=force)


# --- saved runs ---


def load_runs(files: Sequence[str | os.PathLike[str]]) -> tuple[dict[str, Trace], RobotModel]:
    """Load traces and their arm. Raise a ReportError if arms or tools differ."""
    traces: dict[str, Trace] = {}
    for file in map(Path, files):
        traces[file.stem if file.stem not in traces else str(file)] = Trace.load(file)
    arms = {}
    for name, trace in traces.items():
        asked = table(table(trace.meta, "scenario"), "robot")
        arms[name] = {**asked, "name": asked.get("name") or trace.meta.get("robot")}
    if not traces or len(set(map(str, arms.values()))) > 1:
        raise ReportError(f"traces of {arms or 'nothing'}: give traces of one robot with one tool")
    arm, meta = next(iter(arms.values())), next(iter(traces.values())).meta
    if "robot_data" in meta:  # an arm from outside the package
        return traces, restored(meta["robot_data"])
    if not arm["name"]:
        raise ReportError("the trace does not name its robot: in Python, give Replay a robot from mo.load_robot")
    tool = {"tool_length": arm.get("tool_length_m"), "tool_mass": arm.get("tool_mass_kg")}
    return traces, load_robot(arm["name"], **tool)


# --- data of a run ---


def _run_data(trace: Trace, robot: RobotModel, times: Array, color: str) -> dict[str, Any]:
    """Return a run's data at ``times``. After the run's end, the arm stands still."""
    t = trace.t_s
    ticks = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 1)
    origins, rotations = link_frames(robot, trace.q_rad[ticks])
    course = np.unique(np.linspace(0, len(t) - 1, min(len(t), PATH_POINTS)).round().astype(int))
    return {
        "color": {"light": color, "dark": DARK.get(color, color)},
        "end": float(t[-1]), "ended": str(trace.meta.get("ended", "completed")),
        "poses": np.concatenate([rotations, origins[..., None]], axis=3),  # (k, n, 3, 4)
        "tip": trace.tip_m[ticks], "asked": trace.tip_ref_m[ticks],
        "ellipsoid": velocity_ellipsoids(np.array([robot.state(q).J_tip for q in trace.q_rad[ticks]])),
        "course_t": t[course], "course": trace.tip_m[course], "course_asked": trace.tip_ref_m[course],
        "trocar": trace.trocar_m[ticks] if "trocar_m" in trace.columns else None,
        "panels": [_panel(trace, column, ticks) for column in PANELS],
    }  # fmt: skip


def _panel(trace: Trace, column: str, ticks: NDArray[np.intp]) -> dict[str, Array] | None:
    if column not in trace.columns:
        return None
    values = trace.columns[column].astype(np.float64)
    values = PANELS[column][1] * (np.linalg.norm(values, axis=1) if values.ndim == 2 else values)
    t, y = envelope(trace.t_s, values, SERIES_POINTS)
    panel = {"t": t, "y": y, "at": values[ticks]}
    if column == "mu" and "mu_bound" in trace.columns and (known := np.isfinite(trace.mu_bound)).any():
        panel |= {"bound_t": trace.t_s[known], "bound": trace.mu_bound[known]}
    return panel


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return np.round(value, 6).ravel().tolist() if isinstance(value, np.ndarray) else value


def velocity_ellipsoids(jacobians: Array) -> Array:
    """Return S = (J J^T)^(1/2) (k, 3, 3) of J (k, 3, n).

    S maps the unit sphere to the ellipsoid of tip velocities (Yoshikawa 1985).
    """
    axes, lengths, _ = np.linalg.svd(jacobians, full_matrices=False)
    roots: Array = (axes * lengths[:, None, :]) @ np.swapaxes(axes, 1, 2)
    return roots


# --- the look of the arm ---


class Part(NamedTuple):
    """A body of revolution."""

    link: int  #: joint frame (from 0) that carries the part, or `BASE`
    origin: Array  #: (3,) point at height 0, in the link's frame [m]
    axis: Array  #: (3,) unit vector in the link's frame
    radii: Array  #: (k,) radii of the profile [m]
    heights: Array  #: (k,) heights of the profile [m]
    role: str  #: "shell", "joint" or "tool"


def arm_parts(robot: RobotModel) -> list[Part]:
    """Build the parts of arm and tool. The links' thickness is invented."""
    chain, n, here = robot.chain, robot.n, np.zeros(3)
    tip, wrist = chain.offsets
    along = (tip - wrist) / np.linalg.norm(tip - wrist)
    mount = tip - robot.data.tool_length * along
    ends = np.array([*chain.origins, mount])  # ends[k]: end of the link on frame k - 1, in that frame
    lengths = np.linalg.norm(ends, axis=1)
    reach = lengths[:-1].sum()
    radius = np.linspace(0.058, 0.038, n + 1) * reach
    plate = np.array([0.0, 1.9, 1.9, 1.25, 0.0]) * radius[0], np.array([0.0, 0.0, 0.012, 0.03, 0.03]) * reach
    parts = [Part(BASE, here, np.array([0.0, 0.0, 1.0]), *plate, "shell")]
    seen = np.flatnonzero(lengths > SHORTEST_M)
    bend = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 16)
    for k in seen:  # a cone between balls, cut flat at ground and flange
        ball = np.where(bend < 0.0, radius[max(k - 1, 0)], radius[min(k, n - 1)])
        heights = np.where(bend < 0.0, 0.0, lengths[k]) + ball * np.sin(bend)
        heights = heights.clip(0.0 if k == 0 else -np.inf, lengths[k] if k == seen[-1] else np.inf)
        parts.append(Part(int(k) - 1, here, ends[k] / lengths[k], ball * np.cos(bend), heights, "shell"))
    for j, axis in enumerate(chain.axes):
        # Links can have zero length. The longer link at the joint decides whether the joint is drawn as an elbow.
        beside = max(ends[j + 1], chain.rotations[j].T @ ends[j], key=np.linalg.norm)
        across = abs(axis @ beside) < ACROSS * np.linalg.norm(beside)
        drums = [(1.06, 1.12, "shell"), (0.78, 1.22, "joint")] if across else [(1.04, 0.10, "joint")]
        parts += [Part(j, here, axis, *_drum(wide * radius[j], half * radius[j]), role) for wide, half, role in drums]
    thin, length = 0.004, robot.data.tool_length
    foot = np.minimum([0.0, 0.0, 0.012, 0.03, 0.032], 0.5 * length)
    radii = thin * np.array([0.0, 5.0, 5.0, 2.0, 1.0, 1.0, 0.75, 0.0])
    heights = np.array([*foot, length - 0.008, length - 0.003, length])
    return [*parts, Part(n - 1, mount, along, radii, heights, "tool")]


def _drum(radius: float, half: float) -> tuple[Array, Array]:
    edge = 0.15 * min(radius, half)
    heights = np.array([-half, -half, edge - half, half - edge, half, half])
    return np.array([0.0, radius - edge, radius, radius, radius - edge, 0.0]), heights
