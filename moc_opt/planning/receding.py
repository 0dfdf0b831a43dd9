"""A course planned again and again in the run: a short horizon from the measured pose, and V for the rest of the path.

Every 1/rate a way is searched on the map, from the measured pose over the horizon and then by V (`to_go`). It decides
which local maximum of mu to approach. The nonlinear program (`horizon`) makes a smooth course of it. Meanwhile the
loop follows the last answer: a new one is used from the tick of the next solve on, as if it were computed in
parallel.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from moc_opt.errors import TaskError
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import make_course
from moc_opt.planning.horizon import Horizon
from moc_opt.planning.targets import Targets
from moc_opt.planning.to_go import NEARBY_RAD, ToGo

NODES = 10
"""Times of the nonlinear program after the measured pose."""
CATCH_UP = 1.03
"""Factor on the speed that V assumes, allowed on the horizon, so that a late arm can catch up."""
ON_COURSE_RAD = 0.05
"""An arm this near to its course in every joint is on it: a new one begins at the course, which the loop tracks, not at
the measured pose. Else the delay of a solve would close a second loop, which oscillates near singular poses."""
MOST_OFF = 1e-3
"""Of an answer that is followed: tip or wrist off its target [m], a joint beyond a limit or its way [rad]. Levels 1 and
2 keep tip and shaft whatever the third does."""


class Answer(NamedTuple):
    """A course at N + 1 evenly spaced times; cubic between them (Hermite), and at rest after the last."""

    t_s: Array
    q_rad: Array
    v_rad_per_s: Array

    def at(self, t_s: float) -> tuple[Array, Array]:
        """Return the pose (n,) [rad] and velocity (n,) [rad/s]."""
        if t_s >= self.t_s[-1]:
            return self.q_rad[-1], np.zeros_like(self.q_rad[-1])
        dt = self.t_s[1] - self.t_s[0]
        along = max(0.0, (t_s - self.t_s[0]) / dt)
        k = min(int(along), len(self.t_s) - 2)
        s, q, way = along - k, self.q_rad[k], self.q_rad[k + 1] - self.q_rad[k]
        v, last = self.v_rad_per_s[k], self.v_rad_per_s[k + 1]
        bend, turn = 3.0 * way - dt * (2.0 * v + last), dt * (v + last) - 2.0 * way
        return q + s * (dt * v + s * (bend + s * turn)), v + s * (2.0 * bend + 3.0 * s * turn) / dt


class Receding:
    """Wishes of one run, tick by tick; see `moc_opt.control.guide.Guide`."""

    def __init__(
        self, to_go: ToGo, horizon: Horizon, robot: RobotModel, targets: Targets, q_start: Array, period_s: float, *,
        horizon_s: float, rate_per_s: float, gain_per_s: float = 5.0,
    ) -> None:  # fmt: skip
        """Solve once, from the start.

        Args:
            to_go: V over the path.
            targets: tip and wrist over time, closely enough to interpolate between.
            q_start: (n,) at t = 0 [rad].
            period_s: of a tick [s].
            horizon_s: least time from the measured pose to where V takes over [s].
            rate_per_s: solves in a second.
            gain_per_s: of the tracking, as of `moc_opt.planning.follow.Follower`.

        Raises:
            TaskError: no course goes to the end of the path from the start.
        """
        self._to_go, self._horizon, self._robot, self._targets = to_go, horizon, robot, targets
        self._horizon_s, self._every = horizon_s, max(1, round(1.0 / (rate_per_s * period_s)))
        self._period, self._gain = period_s, gain_per_s
        self._q_start = np.array(q_start)
        self.solve_s: list[float] = []
        """Time of every solve since the start [s]."""
        self.refused = 0
        """Solves since the start whose answer was not usable: the one before went on."""
        self.start()
        if self._answer is None:
            raise TaskError("q_start: no course goes to the end of the path from there within joint speeds and limits")

    def start(self) -> None:
        """Go back to t = 0."""
        self.renew()
        self.begin(self._q_start, 0)

    def renew(self) -> None:
        """Make the program's solver anew, for 0.15 s, so that the next run repeats one before to the last bit."""
        self._horizon.forget()

    def begin(self, q: Array, tick: int) -> bool:
        """Begin from rest in a pose (n,) [rad] at a tick; False: no course was found from there."""
        self._tick, self._begun = tick, tick
        self.solve_s, self.refused = [], 0
        self._answer: Answer | None = None
        self._before = self._answer = self._next = self._solve(q, tick * self._period)
        return self._answer is not None

    @property
    def told(self) -> dict[str, float]:
        """Number of ``solves`` since the start, of those ``refused``, and their times [ms]."""
        times = 1e3 * np.array(self.solve_s or [0.0])
        median, high = np.percentile(times, [50.0, 99.0]).tolist()
        return {"solves": len(self.solve_s), "refused": self.refused, "solve_ms_median": median, "solve_ms_p99": high}

    def desired_velocity(self, state: RobotState) -> Array:
        """Return x_d (n,) [rad/s] of this tick; the next call is the next tick's."""
        t = self._tick * self._period
        if self._tick > self._begun and self._tick % self._every == 0:
            self._before, self._answer, self._next = self._answer, self._next, self._solve(state.q, t)
        assert self._answer is not None
        assert self._before is not None
        # From one answer to the next without a jump, over the time until the one after it.
        part = (self._tick % self._every) / self._every
        (q_0, v_0), (q_1, v_1) = self._before.at(t), self._answer.at(t)
        q, v = (1.0 - part) * q_0 + part * q_1, (1.0 - part) * v_0 + part * v_1
        self._tick += 1
        desired: Array = v + self._gain * (q - state.q)
        return desired

    def _solve(self, q: Array, t: float) -> Answer | None:
        """Return the course from a pose at a time; the last one where no answer is usable, or the path is over."""
        path, began = self._to_go.map.targets, time.perf_counter()
        end = min(int(np.searchsorted(path.t_s, t + self._horizon_s)), len(path) - 1)
        if path.t_s[end] - t < 0.5 * path.period_s:
            return self._answer
        found = self._found(q, t, end)
        self.solve_s.append(time.perf_counter() - began)
        self.refused += found is None
        return self._answer if found is None else found

    def _found(self, q: Array, t: float, end: int) -> Answer | None:
        way = self._to_go.way(q, t, end, CATCH_UP)
        if way is None:
            return None
        times, poses, branch, sample = way
        nodes = np.linspace(t, times[-1], NODES + 1)
        there = self._at(nodes[1:])
        guess = self._warm(nodes[1:], times, poses)
        speed = np.zeros(len(q))
        if self._answer is not None:
            followed, speed = self._answer.at(t)
            if np.abs(followed - q).max() < ON_COURSE_RAD:
                q = followed
        answer = self._horizon.solve(guess, q, speed, there, self._to_go.near(end, branch, sample))
        course = np.concatenate([q[None], answer])
        if not self._usable(course, there):
            return None
        velocity = np.gradient(course, nodes, axis=0)
        velocity[0] = speed
        return Answer(nodes, course, velocity)

    def _warm(self, t: Array, times: Array, poses: Array) -> Array:
        """Return the last answer and then the way, as long as they go together; else the way alone."""
        guess, last = _between(t, times, poses), self._answer
        if last is None:
            return guess
        apart = last.q_rad[-1] - _between(last.t_s[-1:], times, poses)[0]
        if np.abs(apart).max() > NEARBY_RAD:
            return guess
        known = t <= last.t_s[-1]
        guess += apart
        guess[known] = _between(t[known], last.t_s, last.q_rad)
        return guess

    def _usable(self, course: Array, there: Targets) -> bool:
        if not np.isfinite(course).all():
            return False
        step = there.period_s * self._horizon.speed
        judged = make_course(self._robot, there, course[1:], self._horizon.margin)
        fast = np.abs(np.diff(course, axis=0)) - step
        return judged.violation < MOST_OFF and float(fast.max()) < MOST_OFF

    def _at(self, t: Array) -> Targets:
        path = self._targets
        tip, wrist = (_between(t, path.t_s, rows) for rows in (path.tip, path.wrist))
        return Targets(t, tip, wrist, np.interp(t, path.t_s, path.arc_length_m))


def _between(t: Array, times: Array, rows: Array) -> Array:
    return np.stack([np.interp(t, times, column) for column in rows.T], axis=1)
