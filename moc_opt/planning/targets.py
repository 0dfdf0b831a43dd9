"""The targets of a path and its trocar at evenly spaced times: tip, and wrist on the line through the trocar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from moc_opt.errors import TaskError
from moc_opt.model.shaft_kernels import desired_wrists
from moc_opt.numerics.arrays import Array, read_only
from moc_opt.tasks import Reference, Trocar

SHALLOWEST_M = 0.002
"""Nearer to the trocar the shaft has no direction."""


@dataclass(frozen=True, eq=False)
class Targets:
    """k times; read-only arrays.

    Example:
        >>> targets = mo.plan(mo.Scenario(duration_s=1.0), times=21, refined=False).targets
        >>> len(targets), targets.tip.shape, round(targets.period_s, 3)
        (21, (21, 3), 0.05)
    """

    t_s: Array
    """(k,) evenly spaced [s]"""
    tip: Array
    """(k,3) [m]"""
    wrist: Array
    """(k,3) N_d = X_d + L e, e from the tip to the trocar [m]"""
    arc_length_m: Array
    """(k,) way of the tip so far [m]"""

    @property
    def period_s(self) -> float:
        """Time between two [s]."""
        return float(self.t_s[1] - self.t_s[0])

    def last(self) -> Targets:
        """Return the last two times alone."""
        return Targets(self.t_s[-2:], self.tip[-2:], self.wrist[-2:], self.arc_length_m[-2:])

    def __len__(self) -> int:
        return len(self.t_s)


def lay_targets(
    reference: Reference, trocar: Trocar, span_m: float, duration_s: float, count: int,
    tool_m: float = np.inf,
) -> Targets:  # fmt: skip
    """Sample the reference and the trocar at ``count`` times from 0 to the end.

    Args:
        span_m: wrist to tip [m].
        duration_s: end of the run [s].
        tool_m: mount to tip [m]: only so much of the shaft can lie in the trocar.

    Raises:
        TaskError: fewer than two times, or the trocar is not on the shaft at one of them.
    """
    if count < 2 or not duration_s > 0.0:
        raise TaskError(f"count = {count}, duration_s = {duration_s:g}: give two times or more and a positive duration")
    t = np.linspace(0.0, duration_s, count)
    tip = np.ascontiguousarray(reference.at(t)[0])
    trocars = trocar.at(t)[0]
    depth = np.linalg.norm(trocars - tip, axis=1)
    deepest = min(span_m, tool_m)
    for k in np.flatnonzero((depth < SHALLOWEST_M) | (depth > deepest))[:1].tolist():
        raise TaskError(
            f"trocar: at t = {t[k]:.2f} s it is {1e3 * depth[k]:.0f} mm from the tip: it must lie on the shaft, "
            f"{1e3 * SHALLOWEST_M:.0f} to {1e3 * deepest:.0f} mm from its tip; make the path smaller, or change depth_m"
        )
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))))
    return Targets(*map(read_only, (t, tip, desired_wrists(tip, trocars, span_m), arc)))
