"""Follow a course in the loop. Level 3 gets the desired joint velocity x_d.

    x_d = dq_c + k (q_c - q)

q_c is the course, dq_c its velocity, q the measured pose, and k = `GAIN_PER_S`.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import TaskError
from moc_opt.planning.course import Course, Targets, between, make_course
from moc_opt.planning.program import Program
from moc_opt.planning.search import NEARBY_RAD, Value
from moc_opt.robots.model import RobotState

GAIN_PER_S = 5.0  #: Gain k of x_d.
NODES = 10  #: Number of time steps of a course made during the run.
CATCH_UP = 1.03  #: Factor on the joint speed limits for courses made during the run.
ON_COURSE_RAD = 0.05
"""If every joint is nearer than this to the old course, a new course begins on the old one. A course that begins at the
measured pose would close a second feedback loop."""
MOST_OFF = 1e-3  #: A course is refused if its tip or wrist error [m] or its excess over limits [rad] is above this.
LOST_RAD = 0.3  #: If a joint is farther than this from the course, the arm has left the course.
NO_COURSE = "q_start: no course within the joint limits and speeds leads from this pose to the end of the path"
ASKED_EACH = 25  #: Ticks between two checks of `LOST_RAD`.


class Piece(NamedTuple):
    """A course with cubic Hermite interpolation. After its end, the last pose is held."""

    t_s: Array  #: (k,) evenly spaced
    q_rad: Array  #: (k,n)
    v_rad_per_s: Array  #: (k,n)

    def at(self, t_s: float) -> tuple[Array, Array]:
        """Return the pose (n,) and velocity (n,)."""
        if t_s >= self.t_s[-1]:
            return self.q_rad[-1], np.zeros_like(self.q_rad[-1])
        dt = self.t_s[1] - self.t_s[0]
        along = max(0.0, (t_s - self.t_s[0]) / dt)
        k = min(int(along), len(self.t_s) - 2)
        s, q, way = along - k, self.q_rad[k], self.q_rad[k + 1] - self.q_rad[k]
        v, last = self.v_rad_per_s[k], self.v_rad_per_s[k + 1]
        bend, turn = 3.0 * way - dt * (2.0 * v + last), dt * (v + last) - 2.0 * way
        return q + s * (dt * v + s * (bend + s * turn)), v + s * (2.0 * bend + 3.0 * s * turn) / dt


class Planner:
    """Makes courses that last ``horizon_s`` [s], or until the end of the path.

    A coarse course is read off the value function, and `Program` smooths it. ``rate_per_s`` is the number of new
    courses per second.
    """

    def __init__(
        self, value: Value, program: Program, targets: Targets, *, horizon_s: float, rate_per_s: float
    ) -> None:
        self._value, self._program, self._targets = value, program, targets
        self._horizon_s, self.rate_per_s = horizon_s, rate_per_s
        self._solve_s: list[float] = []
        self._refused = 0

    def forget(self) -> None:
        """Rebuild the solver (this takes 0.4 s), so that a second run is bitwise equal to the first."""
        self._program.forget()
        self._solve_s, self._refused = [], 0

    @property
    def told(self) -> dict[str, float]:
        """The numbers of solves and refused answers, and two percentiles of the solve time [ms]."""
        median, high = np.percentile(1e3 * np.array(self._solve_s or [0.0]), [50.0, 99.0]).tolist()
        return {"solves": len(self._solve_s), "refused": self._refused, "solve_ms_median": median, "solve_ms_p99": high}

    def plan(self, q: Array, t: float, last: Piece | None) -> Piece | None:
        """Plan a course from a pose (n,) [rad] at a time [s]; None if none is usable. ``last``: the course so far."""
        path, began = self._value.map.targets, time.perf_counter()
        end = min(int(np.searchsorted(path.t_s, t + self._horizon_s)), len(path) - 1)
        if path.t_s[end] - t < 0.5 * path.period_s:
            return None
        found = self._found(q, t, end, last)
        self._solve_s.append(time.perf_counter() - began)
        self._refused += found is None
        return found

    def _found(self, q: Array, t: float, end: int, last: Piece | None) -> Piece | None:
        way = self._value.way(q, t, end, CATCH_UP)
        if way is None:
            return None
        nodes = np.linspace(t, way.t_s[-1], NODES + 1)
        there, speed, guess = self._targets.at(nodes[1:]), np.zeros(len(q)), between(nodes[1:], way.t_s, way.q_rad)
        if last is not None:
            apart = last.q_rad[-1] - between(last.t_s[-1:], way.t_s, way.q_rad)[0]
            if np.abs(apart).max() <= NEARBY_RAD:  # the guess is the previous answer, continued by the coarse course
                known = nodes[1:] <= last.t_s[-1]
                guess += apart
                guess[known] = between(nodes[1:][known], last.t_s, last.q_rad)
            followed, speed = last.at(t)
            if np.abs(followed - q).max() < ON_COURSE_RAD:
                q = followed
        period = float(nodes[1] - nodes[0])
        answer, _ = self._program.solve(guess, q, there, speed, self._value.near(end, way.last), period)
        robot, limits, course = self._program.robot, self._program.limits, np.concatenate([q[None], answer])
        fast = np.abs(np.diff(course, axis=0)) - period * limits.speed_share * robot.v_max
        usable = np.isfinite(course).all() and fast.max() <= MOST_OFF
        if not usable or make_course(robot, there, answer, limits).violation > MOST_OFF:
            return None
        velocity = np.gradient(course, nodes, axis=0)
        velocity[0] = speed
        return Piece(nodes, course, velocity)


class Follower:
    """The desired joint velocities of one run, one per tick."""

    def __init__(
        self, period_s: float, *, course: Course | None = None, planner: Planner | None = None,
        q_start: Array | None = None,
    ) -> None:  # fmt: skip
        """Follow a given course, or a planner's courses from ``q_start`` (n,) [rad].

        With both, the planner takes over once the arm has left the course. Call `start` before the first tick.
        """
        self._period, self._planner, self._q_start = period_s, planner, q_start
        self._given: Piece | None = None
        self.course_mu_mean = None if course is None else course.mu_mean
        """Mean mu of the given course [m^3], or None."""
        if course is not None:
            velocity = np.gradient(course.q_rad, course.t_s, axis=0)
            velocity[-1] = 0.0
            self._given = Piece(course.t_s, course.q_rad, velocity)
        self._every = 0 if planner is None else max(1, round(1.0 / (planner.rate_per_s * period_s)))

    def start(self) -> None:
        """Start at t = 0. Raise a TaskError if there is no course."""
        self._tick, self._begun = 0, -1
        self._now: Piece | None = self._given
        if self._planner is not None:
            self._planner.forget()
            if self._q_start is not None:
                self._begin(self._planner, self._q_start)
        if self._now is None:
            raise TaskError(NO_COURSE)

    def _begin(self, planner: Planner, q: Array) -> None:
        found = planner.plan(q, self._tick * self._period, None)
        if found is not None:
            self._begun = self._tick
            self._before = self._now = self._next = found

    @property
    def told(self) -> dict[str, float]:
        """`Planner.told`, and the time [s] at which the arm left a given course; empty if no planner was used."""
        if self._planner is None or self._begun < 0:
            return {}
        left = {} if self._given is None else {"left_course_s": self._begun * self._period}
        return {**left, **self._planner.told}

    def desired_velocity(self, state: RobotState) -> Array:
        """Return x_d (n,) [rad/s] of this tick, and advance to the next one."""
        t, planner = self._tick * self._period, self._planner
        assert self._now is not None
        if planner is not None and self._begun < 0 and self._tick % ASKED_EACH == 0:
            if np.abs(self._now.at(t)[0] - state.q).max() > LOST_RAD:
                self._begin(planner, state.q)
        elif planner is not None and 0 <= self._begun < self._tick and self._tick % self._every == 0:
            # Each course is followed one solve later, as if its solve took that long. From this tick on, the arm
            # follows `now`, the course of the previous solve. The course of this solve waits in `_next`. If this solve
            # finds no course, the course followed until this tick waits in `_next` instead. For an arm on a rail,
            # returning to it was more accurate than staying on `now`.
            now, self._next = self._next, planner.plan(state.q, t, self._now) or self._now
            self._before, self._now = self._now, now
        q, v = self._now.at(t)
        if self._begun >= 0:  # blend from the previous course to the current one
            part, (q_0, v_0) = (self._tick % self._every) / self._every, self._before.at(t)
            q, v = (1.0 - part) * q_0 + part * q, (1.0 - part) * v_0 + part * v
        self._tick += 1
        desired: Array = v + GAIN_PER_S * (q - state.q)
        return desired
