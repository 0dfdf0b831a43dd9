"""Helpers for tests: a control law, a supervisor and a safety filter."""

import numpy as np

from moc_opt import core
from moc_opt.control import supervisor
from moc_opt.control.law_numbers import FALLBACKS, LATE
from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings


def law(n, arm=None, supervision=None, fallback="damping", **changes):
    """Return a core.Law for n joints. Gains are zero if not given."""
    s = supervisor.SupervisorSettings() if supervision is None else supervision
    wide = np.full(n, 1e3)
    blank = core.Arm(np.zeros((n, 27)), np.zeros((2, 3)), np.eye(3), np.ones((2, n)), np.zeros(3))
    given = {
        "K_X": 0.0, "D_X": 0.0, "K_N": 0.0, "D_N": 0.0, "rcm_lambda": 0.0, "projector": 0, "feedforward": False,
        "K_N2": 0.0, "D_N2": 0.0, "tau_max": np.inf, "k0": 1.0, "c0": 0.01, "c1": 0.01, "c2": 1e-3, "rho": 1e-5,
        "q_min": -wide, "q_max": wide, "v_max": wide, "shaft_margin": 0.0, "spare_speed": 0.0, "observer_gain": 0.0,
        "period": 0.002, "fade": 1.0, "third_level": True, "damped": False, "climbs": False, "check": s.check,
        "box_limit": s.box_limit, "primal_limit": s.primal_limit, "relative_limit": s.relative_limit,
        "opposite_limit": s.opposite_limit, "hold_ticks": s.hold_ticks, "keep_off_limits": s.keep_off_limits,
        "fallback": FALLBACKS.index(fallback), "late": LATE.index(s.late),
        "budget_us": np.inf if s.budget_us is None else s.budget_us, **changes,
    }  # fmt: skip
    for name in ("K_N2", "D_N2", "tau_max", "q_min", "q_max", "v_max"):
        given[name] = np.broadcast_to(np.asarray(given[name], float), (n,)).copy()
    return core.Law(blank if arm is None else arm, **given)


def ticked(robot, state, tip_ref, trocar, x=None, x_d=None, **parts):
    """Return torque (n,) [Nm] and packed subproblem of the first tick."""
    made = law(robot.n, robot.arm, check=False, **parts)
    made.start(state.q, state.v, tip_ref, trocar)
    row = made.begin(state.q, state.v, tip_ref, trocar, x_d)[1]
    return made.finish(0, 0, np.zeros(robot.n) if x is None else x, 0.0)[2], row


def tracking(robot, state, tip_ref, trocar, gains=(0.0, 0.0, 0.0, 0.0), **parts):
    """The torque tau_tip + tau_rcm (n,) [Nm]."""
    names = dict(zip(("K_X", "D_X", "K_N", "D_N"), gains, strict=True))
    return ticked(robot, state, tip_ref, trocar, **names, **parts, third_level=False)[0]


def in_place(state, speed=0.0):
    """Return tip and trocar references at this state. The tip reference moves along x at `speed` [m/s]."""
    tip_ref = np.array([state.tip, [speed, 0.0, 0.0], np.zeros(3)])
    return tip_ref, np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])


def subproblem(robot, state, tip_ref, trocar, **parts):
    return ticked(robot, state, tip_ref, trocar, **parts)[1]


def stand_in(row, Z, fault, fallback="damping"):
    """The x (n,) that replaces a faulty answer if no earlier answer is held."""
    made = law(Z.shape[1], fallback=fallback, hold_ticks=0)
    made.load(row, Z)
    found, x, _ = made.finish(fault, 0, np.zeros(Z.shape[1]), 0.0)
    assert found == fault
    return x


class Supervisor(supervisor.Supervisor):
    """A supervisor that gets the subproblem and the null space from the test."""

    def __init__(self, settings, fallback, n, times_us=None):
        super().__init__(settings, law(n, supervision=settings, fallback=fallback), n, 0.002, times_us)

    def solve(self, session, qp, Z, v=None):
        self._law.load(qp.row, np.ascontiguousarray(Z))
        return super().solve(session, qp, v)[:2]


PERIOD, N = 0.002, 7
REST = np.zeros(N)


def guard_of(robot, q=None, v=REST, carries=True, incision=False, momentum=False, **changes):
    settings = SafetyFilterSettings(**changes)
    mine = SafetyFilter(robot, settings, PERIOD, carries=carries, incision=incision, momentum=momentum)
    mine.start(robot.data.q_home if q is None else q, v)
    return mine


def off_by(robot, q, distance):
    """A registered trocar (2, 3) that the shaft misses by `distance` [m]."""
    pose = robot.tool_pose(q)
    return np.stack([pose[3] - 0.15 * pose[2] + distance * pose[0], np.zeros(3)])


def weight(robot, q, force=0.0):
    """The wrench that the sensor measures at rest, from the tool's weight and a `force` [N] across the shaft."""
    pose, length = robot.tool_pose(q), robot.data.tool_length
    load, pull = np.array([0.0, 0.0, -9.81 * robot.data.tool_mass]), force * pose[1]
    moment = np.cross(0.5 * length * pose[2], load) + np.cross((length - 0.15) * pose[2], pull)
    return np.concatenate([pose[:3] @ (load + pull), pose[:3] @ moment])
