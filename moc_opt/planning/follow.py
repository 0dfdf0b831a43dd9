"""A course in the loop: the joint velocity that the third level is asked for, in place of the climb of mu.

    x_d(t) = dq_c(t) + k (q_c(t) - q),   projected on ker A by the subproblem itself

q_c is the course, k the gain on its error.

An arm that is far from its course is not led back by that: the way there may turn away from it at first, and close to a
singular pose, where one joint alone is free, the error's projection is zero at poses off the course. A horizon that
plans anew from where the arm is (`receding`) takes over then.
"""

from __future__ import annotations

import numpy as np

from moc_opt.errors import TaskError
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import Course
from moc_opt.planning.receding import Receding

LOST_RAD = 0.3
"""Farther from its course in one joint, an arm has left it: some ten times the usual error on a course."""
ASKED_EACH = 25
"""Ticks between two checks whether the arm has left its course."""


class Follower:
    """Wishes of one run, tick by tick; see `moc_opt.control.guide.Guide`."""

    def __init__(
        self, course: Course, period_s: float, *, gain_per_s: float = 5.0, rescue: Receding | None = None
    ) -> None:
        """Sample the course at the ticks.

        Args:
            course: from t = 0 on; after its end its last pose is held.
            period_s: of a tick [s].
            gain_per_s: k [1/s].
            rescue: guide that takes over from the present pose if the arm has left its course.

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
        self._gain, self._tick, self._period = gain_per_s, 0, period_s
        self._rescue, self._lost_s = rescue, np.inf
        self.course_mu_mean = course.mu_mean
        """Mean manipulability of the course [m^3]: what the run has where nothing takes the arm from it."""

    def start(self) -> None:
        """Go back to t = 0, and to the course."""
        self._tick, self._lost_s = 0, np.inf
        if self._rescue is not None:
            self._rescue.renew()  # not where it takes over: within a tick that would stall the loop

    @property
    def told(self) -> dict[str, float]:
        """When the course was left [s], and what `Receding.told` has since; empty where it was not."""
        return {"left_course_s": self._lost_s, **self._rescue.told} if self._rescue and self._lost_s < np.inf else {}

    def desired_velocity(self, state: RobotState) -> Array:
        """Return x_d (n,) [rad/s] of this tick; the next call is the next tick's."""
        if self._rescue is not None and self._lost_s < np.inf:
            return self._rescue.desired_velocity(state)
        k, tick = min(self._tick, len(self._q) - 1), self._tick
        off = self._q[k] - state.q
        lost = self._rescue is not None and tick % ASKED_EACH == 0 and np.abs(off).max() > LOST_RAD
        if self._rescue is not None and lost and self._rescue.begin(state.q, tick):
            self._lost_s = tick * self._period
            return self._rescue.desired_velocity(state)
        self._tick += 1
        found: Array = self._v[k] + self._gain * off
        return found
