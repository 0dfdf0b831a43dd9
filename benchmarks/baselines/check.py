"""Check that a controller does the job: a second on an ideal arm without friction, noise or model error.

python -m benchmarks.baselines.check NAME   ends with status 0 when the peer does its job here
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from benchmarks.baselines.base import Peer
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.numerics.arrays import Array
from moc_opt.tasks import Reference, Trocar, make_path, shaft_distance

Inputs = tuple[Array, Array, Array, Array]
"""q, v, tip reference and trocar of one tick."""

PERIOD_S = 0.002
TOLERANCE_MM = 0.5
"""On tip and shaft, in the second half of the second."""
CLIMB_PERCENT = 1.0
"""The manipulability has to rise by this much at least."""


class Job(NamedTuple):
    """References of a run: where tip and trocar are at every tick."""

    q_start: Array
    """(n,) [rad]"""
    tip_refs: Array
    """(N, 3, 3) rows X_d, dX_d, ddX_d"""
    trocars: Array
    """(N, 2, 3) rows P_t, dP_t"""


class Verdict(NamedTuple):
    """How well a controller did it."""

    tip_error_max_mm: float
    rcm_error_max_mm: float
    mu_rise_percent: float

    @property
    def failure(self) -> str | None:
        """The failed part of the job; None if there is none."""
        if not self.tip_error_max_mm <= TOLERANCE_MM:
            return f"the tip is {self.tip_error_max_mm:.3g} mm off its reference, {TOLERANCE_MM} are allowed"
        if not self.rcm_error_max_mm <= TOLERANCE_MM:
            return f"the shaft is {self.rcm_error_max_mm:.3g} mm off the trocar, {TOLERANCE_MM} are allowed"
        if not self.mu_rise_percent >= CLIMB_PERCENT:
            return f"the manipulability rose by {self.mu_rise_percent:.3g} %, {CLIMB_PERCENT} are asked for"
        return None


def job(robot: RobotModel, duration_s: float = 1.0, offset_m: float = 2e-4) -> Job:
    """Return a circle from the home pose, the tip beginning ``offset_m`` beside it, the trocar 0.15 m above the tip."""
    state = robot.state(robot.data.q_home)
    start = state.tip + np.array([0.0, 0.0, offset_m])
    path = make_path("circle", start, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), radius=0.03)
    t = PERIOD_S * np.arange(round(duration_s / PERIOD_S))
    trocar = Trocar(state.tip - 0.15 * state.tool_direction)
    return Job(state.q.copy(), np.stack(Reference(path, 0.05, 0.2).at(t), axis=1), np.stack(trocar.at(t), axis=1))


def perform(peer: Peer, robot: RobotModel, work: Job) -> tuple[Array, list[Inputs]]:
    """Return the poses (N, n) of the ideal arm under the controller after each tick, and the inputs of each tick.

    No plant and no safety filter: most peers answer with velocities, which the closed loop's step does not take.
    """
    q, v = work.q_start.copy(), np.zeros(robot.n)
    poses, given = np.empty((len(work.tip_refs), robot.n)), []
    for k in range(len(poses)):
        given.append((q, v, work.tip_refs[k], work.trocars[k]))
        asked = peer.tick(*given[-1])
        if peer.level == "torque":
            state = robot.state(q, v)
            v = v + PERIOD_S * np.linalg.solve(state.M, asked - state.h)
        else:
            v = np.array(asked)
        q = q + PERIOD_S * v
        poses[k] = q
    return poses, given


def verdict(poses: Array, robot: RobotModel, work: Job) -> Verdict:
    """Tell how well poses (N, n) of `perform` did the job: tip and shaft in the second half, and mu at the end."""
    if not np.isfinite(poses).all():
        return Verdict(np.inf, np.inf, -100.0)
    late = slice(len(poses) // 2, None)
    states = [robot.state(q) for q in poses[late]]
    # The pose after a tick is measured by the references of the next one.
    tips, wrists = (np.array([getattr(state, name) for state in states]) for name in ("tip", "wrist"))
    wanted = np.roll(work.tip_refs[:, 0], -1, axis=0)[late]
    off = np.linalg.norm(tips - wanted, axis=1)[:-1]
    aside = shaft_distance(tips, wrists, work.trocars[late, 0])
    before = robot.state(work.q_start).mu
    return Verdict(1e3 * float(off.max()), 1e3 * float(aside.max()), 100.0 * (states[-1].mu / before - 1.0))


def main(name: str) -> int:
    """Return 0 when the named peer does its job, else 1 and why not on stderr."""
    from benchmarks.baselines import create

    robot = load_robot()
    try:
        work = job(robot)
        failure = verdict(perform(create(name, robot, PERIOD_S), robot, work)[0], robot, work).failure
    except Exception as error:  # noqa: BLE001 - whatever another library raises is a reason, not a crash
        failure = f"{type(error).__name__}: {error}"
    if failure is not None:
        print(failure, file=sys.stderr)
    return int(failure is not None)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
