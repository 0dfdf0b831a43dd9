"""A course in the loop: the joint velocity that the third level is asked for, in place of the climb of mu.

    x_d(t) = dq_c(t) + k (q_c(t) - q),   projected on ker A by the subproblem itself

q_c is the course, k the gain on its error.
"""

from __future__ import annotations

import numpy as np

from moc_opt.errors import TaskError
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import Course


class Follower:
    """Wishes of one run, tick by tick; see `moc_opt.control.guide.Guide`."""

    def __init__(self, course: Course, period_s: float, *, gain_per_s: float = 5.0) -> None:
        """Sample the course at the ticks.

        Args:
            course: from t = 0 on; after its end its last pose is held.
            period_s: of a tick [s].
            gain_per_s: k [1/s].

        Raises:
            TaskError: the period is not positive, or the gain negative.
        """
        if not period_s > 0.0 or not gain_per_s >= 0.0:
            raise TaskError(f"period_s = {period_s:g}, gain_per_s = {gain_per_s:g}: give above 0, and 0 or more")
        t = period_s * np.arange(int(np.ceil(course.t_s[-1] / period_s)) + 1)
        self._q = np.stack([np.interp(t, course.t_s, joint) for joint in course.q_rad.T], axis=1)
        v = np.gradient(course.q_rad, course.t_s, axis=0)
        self._v = np.stack([np.interp(t, course.t_s, joint) for joint in v.T], axis=1)
        self._v[-1] = 0.0
        self._gain, self._tick = gain_per_s, 0

    def start(self) -> None:
        """Go back to t = 0."""
        self._tick = 0

    def wish(self, state: RobotState) -> Array:
        """x_d (n,) [rad/s] of this tick; the next call is the next tick's."""
        k = min(self._tick, len(self._q) - 1)
        self._tick += 1
        found: Array = self._v[k] + self._gain * (self._q[k] - state.q)
        return found
