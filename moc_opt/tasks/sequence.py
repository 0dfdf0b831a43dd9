"""References one after the other: an approach, then the task."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from moc_opt.errors import TaskError
from moc_opt.tasks.checks import TimeLike, Vector, number, sampled

_TOUCH_M = 1e-9


class TipReference(Protocol):
    """A tip reference over time, from rest to rest, as `Reference` is one."""

    @property
    def t_start(self) -> float:
        """When it leaves its start [s]."""

    @property
    def duration(self) -> float:
        """How long it is under way [s]."""

    @property
    def v_max(self) -> float:
        """Its speed is nowhere above this [m/s]."""

    @property
    def a_max(self) -> float:
        """Its acceleration is nowhere above this [m/s^2]."""

    def rows(self, t: float) -> Vector:
        """Return X_d, dX_d, ddX_d as rows (3, 3) at a time [s]; at rest before and after."""


class ReferenceSequence:
    """Legs that begin where the last one ended, each from rest to rest.

    A leg's own `t_start` is a rest before it: the sequence begins with the first leg's, and every further leg
    leaves its `t_start` after the one before has arrived.
    """

    def __init__(self, legs: Sequence[TipReference]) -> None:
        """Put them in order.

        Raises:
            TaskError: there is none, a rest is negative, or a leg begins elsewhere than the last one ended.
        """
        if not legs:
            raise TaskError("a sequence of references needs one leg or more")
        self.legs = tuple(legs)
        self._offsets: list[float] = []  # what a leg's own clock is behind the sequence's
        ready = 0.0
        for i, leg in enumerate(self.legs):
            if i > 0:
                if number(f"t_start of leg {i}", leg.t_start) < 0.0:
                    raise TaskError(f"t_start = {leg.t_start!r} s of leg {i} is negative: give a rest of zero or more")
                last = self.legs[i - 1]
                gap = leg.rows(leg.t_start)[0] - last.rows(last.t_start + last.duration)[0]
                if float(np.abs(gap).max()) > _TOUCH_M:
                    raise TaskError(
                        f"leg {i} begins {1e3 * float(np.linalg.norm(gap)):.3g} mm from the end of leg {i - 1}: "
                        "put a line between them"
                    )
            self._offsets.append(ready)
            ready += leg.t_start + leg.duration
        self.t_start = self.legs[0].t_start
        self.duration = ready - self.t_start
        self.v_max = max(leg.v_max for leg in self.legs)
        self.a_max = max(leg.a_max for leg in self.legs)

    def starts(self) -> list[float]:
        """When each leg leaves its start [s]."""
        return [offset + leg.t_start for offset, leg in zip(self._offsets, self.legs, strict=True)]

    def at(self, t: TimeLike) -> tuple[Vector, Vector, Vector]:
        """Return point, velocity, acceleration; arguments, shapes and errors as for `Reference.at`."""
        x, dx, ddx = sampled("t", t, self.rows)
        return x, dx, ddx

    def rows(self, t: float) -> Vector:
        """Return X_d, dX_d, ddX_d as the rows of one (3, 3) array, for one time [s].

        Raises:
            TaskError: t is NaN.
        """
        i = max(bisect_right(self._offsets, t) - 1, 0)
        return self.legs[i].rows(t - self._offsets[i])
