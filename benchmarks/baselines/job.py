"""The job of one tick: what a peer is asked, what its library may lack, and the check that it does it.

The check is a second on an ideal arm without friction, noise or model error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import numpy as np

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.robots.model import RobotModel
from moc_opt.tasks import Reference, Trocar, make_path, shaft_distance

Inputs = tuple[Array, Array, Array, Array]
"""q, v, tip reference and trocar of one tick."""
Level = Literal["torque", "velocity"]

PERIOD_S = 0.002
TOLERANCE_MM = 0.5
"""On tip and shaft, in the second half of the second."""
CLIMB_PERCENT = 1.0
"""The manipulability has to rise by this much at least."""
CLIMB = 30.0
"""Joint velocity per gradient of the manipulability [1/m^3 rad^2/s]: c2/rho of the subproblem, here 1/0.033."""
STIFFNESS_PER_S = 100.0
"""How fast a velocity-level peer closes an error of tip or shaft [1/s]."""


class Peer(Protocol):
    """A controller of another library, set up for the job."""

    @property
    def level(self) -> Level:
        """The result of a tick; a velocity still needs a servo."""

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Return the joint torques (n,) [Nm] or velocities (n,) [rad/s].

        Args:
            q, v: (n,) measured [rad], [rad/s].
            tip_ref: (3, 3) rows X_d, dX_d, ddX_d.
            trocar: (2, 3) rows P_t, dP_t.
        """


def tip_gradient(robot: RobotModel) -> Callable[[Array], Array]:
    """Return dmu/dq (n,) as a function of q, by the core: no peer is slowed by a term that its library lacks."""
    rest = np.zeros(robot.n)
    return lambda q: robot.state(np.ascontiguousarray(q), rest).grad_mu


def wrist_reference(tip_ref: Array, trocar: Array, span: float) -> Array:
    """Return wrist [m] and velocity [m/s], (2, 3), that put the shaft of a tip on its reference through the trocar."""
    found = np.empty((2, 3))
    core.desired_wrist(tip_ref[0], tip_ref[1], trocar, span, found)
    return found


class Job(NamedTuple):
    """Start (n,) [rad], and at every tick the rows X_d, dX_d, ddX_d (N, 3, 3) and P_t, dP_t (N, 2, 3)."""

    q_start: Array
    tip_refs: Array
    trocars: Array


class Verdict(NamedTuple):
    """How well a controller did it."""

    tip_error_max_mm: float
    rcm_error_max_mm: float
    mu_rise_percent: float

    @property
    def failure(self) -> str | None:
        """The failed part of the job; None if there is none."""
        for what, off in (("tip", self.tip_error_max_mm), ("shaft", self.rcm_error_max_mm)):
            if not off <= TOLERANCE_MM:
                return f"the {what} is {off:.3g} mm off, {TOLERANCE_MM} are allowed"
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
