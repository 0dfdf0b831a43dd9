"""Find joints that oscillate faster than any task requires."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import TraceError
from moc_opt.trace.trace import MissingDataError, Trace

Floats = NDArray[np.float64]
Flags = Sequence[bool] | NDArray[np.bool_]

LIMIT_RAD_PER_S, LIMIT_NM = 0.2, 10.0
LIMIT_M_PER_S, LIMIT_N = 0.08, 100.0  #: Limits for a prismatic joint.
PARTS, LOUDEST, KEPT_UP = 8, 2, 0.5
"""The window has 8 parts. Unlike a jerk, an oscillation exceeds half the limit even without its 2 loudest parts."""
ABOVE_HZ, WINDOW_S, START_S, SHORTEST_S = 8.0, 1.0, 0.5, 1e-6
"""START_S: time at the start that is left out. SHORTEST_S: shortest allowed time between ticks."""


class Shaking(NamedTuple):
    """The largest oscillation in a run."""

    joint: int  #: index, from 0
    rms: float  #: root mean square in the worst window, in the column's unit
    frequency_Hz: float
    rest: float  #: like rms, without the loudest quarter of the window

    def above(self, limit: float) -> bool:
        """Return whether it exceeds the limit and is not a single jerk."""
        return self.rms > limit and self.rest > KEPT_UP * limit


def shaking(trace: Trace, column: str, limits: ArrayLike | None = None) -> Shaking:
    """Find the joint that oscillates most: root mean square of its part above ``ABOVE_HZ`` in a window of ``WINDOW_S``.

    Args:
        column: ``v_rad_per_s`` or ``tau_Nm``, (N, n).
        limits: (n,) limit of each joint. Joints are compared by rms / limit. None: by rms.

    Raises:
        MissingDataError: a column or ticks are missing, or there are fewer than four ticks.
        TraceError: the time does not increase.
    """
    values, time = np.asarray(getattr(trace, column), dtype=np.float64), np.asarray(trace.t_s, dtype=np.float64)
    if len(trace) < 4:
        raise MissingDataError(f"the trace has {len(trace)} ticks: give four or more to find an oscillation")
    if "tick" in trace.columns and (np.diff(trace.tick) != 1).any():
        raise MissingDataError("some ticks are left out: give consecutive ticks to find an oscillation")
    period = float(time[-1] - time[0]) / (len(time) - 1)
    if not SHORTEST_S <= period < np.inf:
        raise TraceError(
            f"column 't_s' does not increase by {SHORTEST_S:g} s or more from tick to tick: give the time of each tick"
        )
    first = min(round(START_S / period), len(time) // 2)
    window = min(round(WINDOW_S / period), len(time) - first)
    fast = above(values, max(1, round(1.0 / (ABOVE_HZ * period))))[first:]
    total = np.concatenate([np.zeros((1, fast.shape[1])), np.cumsum(fast * fast, axis=0)])
    squares = np.maximum(total[window:] - total[:-window], 0.0) / window
    if limits is None:
        return _at(fast, squares, squares, period)
    bounds = np.broadcast_to(np.asarray(limits, dtype=np.float64), squares.shape[1:])
    shares = squares / np.square(bounds)
    loudest = found = _at(fast, squares, shares, period)
    while not found.above(bounds[found.joint]) and shares.max() > 1.0:
        # Remove this jerk, and look elsewhere.
        away = np.arange(len(shares)) - np.argmax(shares[:, found.joint])
        shares[np.abs(away) <= window // PARTS, found.joint] = 0.0
        found = _at(fast, squares, shares, period)
    return found if found.above(bounds[found.joint]) else loudest


def _at(fast: Floats, squares: Floats, shares: Floats, period: float) -> Shaking:
    window = len(fast) - len(squares) + 1
    row, joint = (int(i) for i in np.unravel_index(np.argmax(shares), shares.shape))
    worst = fast[row : row + window, joint]
    spectrum = np.abs(np.fft.rfft((worst - worst.mean()) * np.hanning(window)))
    least = min(math.ceil(ABOVE_HZ * window * period), len(spectrum) - 1)
    frequency = float(least + np.argmax(spectrum[least:])) / (window * period)
    parts = np.sort([float(part @ part) for part in np.array_split(worst, PARTS)])[:-LOUDEST]
    rest = float(np.sqrt(parts.sum() / (window * (1.0 - LOUDEST / PARTS))))
    return Shaking(joint, float(np.sqrt(squares[row, joint])), frequency, rest)


def above(values: Floats, width: int) -> Floats:
    """Return the rows (N, k) minus their centred mean over ``width`` rows."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    place, half = np.arange(len(values)), width // 2
    begin, end = np.maximum(place - half, 0), np.minimum(place + half + 1, len(values))
    return np.asarray(values - (total[end] - total[begin]) / (end - begin)[:, None])


def describe(trace: Trace, joint_names: Sequence[str], slides: Flags) -> str:
    """Say which joint oscillates, its frequency and rms ("" if none does). ``slides`` marks the prismatic joints."""
    speeds = np.where(slides, LIMIT_M_PER_S, LIMIT_RAD_PER_S)
    efforts = np.where(slides, LIMIT_N, LIMIT_NM)
    v, tau = shaking(trace, "v_rad_per_s", speeds), shaking(trace, "tau_Nm", efforts)
    if v.above(speeds[v.joint]):
        return f"{joint_names[v.joint]} at {v.frequency_Hz:.0f} Hz, {v.rms:.2f} {'m' if slides[v.joint] else 'rad'}/s"
    if tau.above(efforts[tau.joint]):
        unit = "N" if slides[tau.joint] else "Nm"
        return f"{joint_names[tau.joint]} at {tau.frequency_Hz:.0f} Hz, {tau.rms:.0f} {unit}"
    return ""


def judged_for_oscillation(trace: Trace, joint_names: Sequence[str], slides: Flags) -> Trace:
    """Return the trace. If the run oscillated, the result's ``meta["ended"]`` says so."""
    ended, stopped_s = trace.meta.get("ended"), trace.meta.get("stopped_at_s")
    judged = trace if stopped_s is None else trace.head(int(np.searchsorted(trace.t_s, stopped_s)))
    brief = len(judged) < 4 or judged.t_s[-1] - judged.t_s[0] < START_S + 0.5 * WINDOW_S
    if brief or (ended != "completed" and stopped_s is None):
        return trace
    found = describe(judged, joint_names, slides)
    said = f"oscillated: {found}" if stopped_s is None else f"{ended}; oscillated before: {found}"
    return trace.with_meta(ended=said) if found else trace
