"""Measurements at the incision: the distance of the shaft from the registered trocar, and the trocar's force.

The force comes from the six-axis sensor at the tool's mount. In tool axes (z along the shaft, L from mount to tip, the
trocar a depth d before the tip) the tool's weight is subtracted from the reading. The rest across the shaft is the
sum of the trocar's force f and the force g of a contact at the tip:

    force = f + g,   torque about the mount = (L - d) z x f + L z x g,   hence   f = (L force - torque x z) / d

The depth d is computed from the encoders: if it is wrong, the trocar's force may be taken for a contact of the tip.
So at most a given force is attributed to g, and the rest counts as the trocar's.

At depths below ``SHORTEST_DEPTH_M`` the two cannot be separated, and the whole force counts as the trocar's.
The tool's inertia force is not subtracted: some 0.3 N for each m/s^2 of the default tool.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

SHORTEST_DEPTH_M = 0.05
_GRAVITY_M_PER_S2 = 9.81


@njit(cache=True, nogil=True)
def rcm_error(pose: Array, point: Array) -> float:
    """Return the distance of the shaft's line from the trocar P [m].

    Args:
        pose: (4, 3) rows: the tool's axes x, y, z (along the shaft), and its tip X [m].
        point: (3,) P [m].
    """
    square = 0.0
    for axis in range(2):
        across = 0.0
        for i in range(3):
            across += pose[axis, i] * (point[i] - pose[3, i])
        square += across * across
    return float(np.sqrt(square))


@njit(cache=True, nogil=True)
def trocar_force(pose: Array, point: Array, wrench: Array, mass: float, length: float, touch: float) -> float:
    """Return the force of the trocar on the shaft, across it [N]; NaN where the sensor's reading is no number.

    Args:
        pose: (4, 3) as for ``rcm_error``.
        point: (3,) the trocar P [m].
        wrench: (6,) force [N] and torque [Nm] of the tool on its mount, tool axes.
        mass: of the tool, a uniform rod [kg].
        length: L, from its mount to its tip [m].
        touch: largest force across the shaft attributed to the tip [N]; the rest counts as the trocar's.
    """
    depth = 0.0
    for i in range(3):
        depth += pose[2, i] * (pose[3, i] - point[i])
    weight_x, weight_y = -mass * _GRAVITY_M_PER_S2 * pose[0, 2], -mass * _GRAVITY_M_PER_S2 * pose[1, 2]
    force_x, force_y = wrench[0] - weight_x, wrench[1] - weight_y
    whole = np.sqrt(force_x * force_x + force_y * force_y)
    if depth >= SHORTEST_DEPTH_M:
        # torque x z; the weight acts in the middle of the rod
        moment_x, moment_y = wrench[4] - 0.5 * length * weight_x, -wrench[3] - 0.5 * length * weight_y
        force_x, force_y = (length * force_x - moment_x) / depth, (length * force_y - moment_y) / depth
        force = np.sqrt(force_x * force_x + force_y * force_y)
        return float(whole - touch if whole - touch > force else force)
    return float(whole)


BELOW, ABOVE, NO_READING = 0, 1, 2


@njit(cache=True, nogil=True)
def take(tool: Array, lowest: Array, means: Array, pose: Array, point: Array, wrench: Array) -> int:
    """Update both mean squares; return whether one is above ``lowest`` (2,), or the sensor's reading is NaN.

    Args:
        tool: (4,) mass [kg], length [m], ``touch`` as for ``trocar_force`` [N], and a reading's share of the means.
        lowest: (2,) [m^2], [N^2].
        means: (2,) changed in place.
        pose, point, wrench: as for ``trocar_force``.
    """
    distance, force = rcm_error(pose, point), trocar_force(pose, point, wrench, tool[0], tool[1], tool[2])
    means[0] += tool[3] * (distance * distance - means[0])
    if not np.isfinite(force):
        return NO_READING
    means[1] += tool[3] * (force * force - means[1])
    return BELOW if means[0] <= lowest[0] and means[1] <= lowest[1] else ABOVE


@dataclass
class Watched:
    """One root mean square with a warning level and a limit; None: off."""

    name: str
    unit: str
    scale: float
    """from SI to ``unit``"""
    warning: float | None
    limit: float | None
    first_tick: int = -1
    largest: float = 0.0

    @property
    def lowest_square(self) -> float:
        """Square of the lower of both levels; infinite where both are off."""
        return min((level**2 for level in (self.warning, self.limit) if level is not None), default=np.inf)

    def take(self, value: float, tick: int) -> str:
        """Note the value; return the reason to stop where it is above the limit."""
        if self.warning is not None and value > self.warning:
            self.first_tick = tick if self.first_tick < 0 else self.first_tick
            self.largest = max(self.largest, value)
        if self.limit is None or value <= self.limit:
            return ""
        return f"{self.name} has been above {self.scale * self.limit:g} {self.unit}"


class Incision:
    """Root mean squares, over a time constant, of RCM error and trocar force, against their levels.

    Args:
        tool: mass [kg] and length [m] of the tool, and the largest force attributed to its tip [N].
        share: control period over the time constant.
        patience_ticks: readings of the wrench sensor in a row that may be NaN.
        rcm: warning level and limit of the RCM error against the registered trocar [m]; None: off.
        force: the same of the trocar's force [N].

    Attributes:
        tool, lowest, means: as ``take`` takes them.
        point: (3,) where the trocar was registered last [m].
    """

    def __init__(
        self,
        tool: tuple[float, float, float],
        share: float,
        patience_ticks: int,
        rcm: tuple[float | None, float | None],
        force: tuple[float | None, float | None],
    ) -> None:
        self.tool, self._patience = np.array([*tool, share]), patience_ticks
        self._levels = (("the RCM error", "mm", 1e3, *rcm), ("the trocar's force", "N", 1.0, *force))
        self.lowest, self.means, self.point = np.zeros(2), np.zeros(2), np.zeros(3)
        self.forget()

    def forget(self) -> None:
        """Forget all readings."""
        self._tick, self._unread = -1, 0
        self.means[:], self.point[:] = 0.0, np.nan
        self._watched = [Watched(*given) for given in self._levels]
        self.lowest[:] = [watched.lowest_square for watched in self._watched]

    def pressed(self, pose: Array, wrench: Array) -> float:
        """Return the trocar's force on the shaft [N] at the last registered place; NaN where it has no reading."""
        return float(trocar_force(pose, self.point, wrench, *self.tool[:3]))

    def passed(self, ticks: int) -> None:
        """Note ticks at which ``take`` found nothing."""
        if ticks > 0:
            self._tick, self._unread = self._tick + ticks, 0

    def reason(self, found: int) -> str:
        """Return the reason to stop after what ``take`` found at one tick, or ""."""
        if found == BELOW:
            self.passed(1)
            return ""
        self._tick += 1
        self._unread = self._unread + 1 if found == NO_READING else 0
        if self._unread > self._patience and np.isfinite(self.lowest[1]):
            return "the wrench sensor's readings are no numbers"
        reason = ""
        for watched, square in zip(self._watched, self.means.tolist(), strict=True):
            reason = reason or watched.take(square**0.5, self._tick)
        return reason

    def warnings(self, period: float) -> list[dict[str, Any]]:
        """List figures that were above their warning level: name, first time [s], and the largest value."""
        return [
            {
                "of": w.name, "first_s": w.first_tick * period, "largest": w.scale * w.largest, "unit": w.unit,
                "level": w.scale * w.warning,
            }
            for w in self._watched if w.warning is not None and w.first_tick >= 0
        ]  # fmt: skip
