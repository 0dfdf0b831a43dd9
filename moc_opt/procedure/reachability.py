"""Whether the arm can do a task at all, found out before anything moves: the path followed by kinematics alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import RobotError, TaskError
from moc_opt.model.inverse_kinematics import Placed, solve_pose
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.tasks import Reference, Trocar

_TIMES = 1500
_SHALLOWEST_M = 0.002
_START_TOLERANCE_M = 0.002


class UnreachableError(TaskError):
    """The arm cannot do this task; `field` says what is in the way, `arc_length_m` where on the path."""

    def __init__(self, field: str, arc_length_m: float, problem: str, cure: str) -> None:
        """Build the message.

        Args:
            field: the setting to change: "path", "trocar", "joint limits", "v_max", "start".
            arc_length_m: place on the path [m].
        """
        super().__init__(f"{field}: at {1e3 * arc_length_m:.1f} mm along the path {problem}: {cure}")
        self.field, self.arc_length_m = field, arc_length_m


@dataclass(frozen=True, eq=False, repr=False)
class Reach:
    """One way through the task; one row for each point of the path that was looked at."""

    t_s: Array
    """(k,) time of the reference [s]"""
    arc_length_m: Array
    """(k,) way of the tip so far [m]"""
    q_rad: Array
    """(k, n) the pose taken there, inside the joint limits"""
    speed_share: Array
    """(k,) largest share of a joint's speed limit that is needed there, 1 is all of it"""
    margin_rad: Array
    """(k,) distance of the nearest joint from its limit [rad]"""
    as_given: bool
    """Whether it begins at the pose that was given; False: the elbow has to travel to q_rad[0] first."""


@dataclass(frozen=True, eq=False)
class _Places:
    """Where tip and trocar are wanted, at times close together."""

    t: Array
    arc: Array
    tip: Array
    tip_velocity: Array
    trocar: Array
    trocar_velocity: Array


def check_reachable(
    robot: RobotModel, q_start: ArrayLike, reference: Reference, trocar: Trocar | ArrayLike, *,
    spacing_m: float = 0.002, until_s: float = np.inf,
) -> Reach:  # fmt: skip
    """Follow the reference with the shaft through the trocar, inside joint limits and joint speeds.

    Each point is solved from the pose before it, with the joints that have room taking over from those at a
    limit. If that ends nowhere, the path is tried again from the middle of the starting self-motion. A
    refused path may still be possible along a way that this search does not try; an accepted path is possible.

    Args:
        q_start: (n,) the pose it begins with, its tip at the start of the reference [rad].
        reference: where the tip has to be, and when.
        trocar: where the shaft has to pass; a point (3,) [m] rests.
        spacing_m: distance of the points that are looked at [m].
        until_s: time at which the run ends [s]; the reference after it is ignored.

    Raises:
        UnreachableError: a point, a joint speed or the trocar is out of reach; names the field, the arc length
            and the cure.
        RobotError: q_start is not usable.
    """
    state = robot.state(q_start)
    places = _places(reference, trocar if isinstance(trocar, Trocar) else Trocar(trocar), spacing_m, until_s)
    away = float(np.linalg.norm(state.tip - places.tip[0]))
    if away > _START_TOLERANCE_M:
        problem = f"the reference begins {1e3 * away:.1f} mm from the tip"
        raise UnreachableError("start", 0.0, problem, "begin it at the tip, or put a line from the tip before it")
    _check_depth(robot, places)
    try:
        return _follow(robot, state.q, places, reference, as_given=True)
    except UnreachableError:
        other = _middle(robot, state.q)
        if other is None:
            raise
        try:
            return _follow(robot, other, places, reference, as_given=False)
        except UnreachableError:
            pass  # what stopped the given pose is what the user should hear
        raise


def _places(reference: Reference, trocar: Trocar, spacing_m: float, until_s: float) -> _Places:
    end = max(reference.t_start, min(reference.t_start + reference.duration, until_s))
    times = np.linspace(reference.t_start, end, _TIMES)
    tip, velocity = map(np.ascontiguousarray, reference.at(times)[:2])
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))))
    count = max(2, int(min(np.ceil(arc[-1] / spacing_m) + 1, _TIMES)))
    chosen = np.unique(np.searchsorted(arc, np.linspace(0.0, arc[-1], count)).clip(0, _TIMES - 1))
    return _Places(times[chosen], arc[chosen], tip[chosen], velocity[chosen], *trocar.at(times[chosen]))


def _check_depth(robot: RobotModel, places: _Places) -> None:
    depth = np.linalg.norm(places.trocar - places.tip, axis=1)
    longest = robot.data.tool_length
    for k in np.flatnonzero((depth > longest) | (depth < _SHALLOWEST_M))[:1].tolist():
        if depth[k] > longest:
            raise UnreachableError(
                "trocar",
                places.arc[k],
                f"the trocar is {1e3 * depth[k]:.0f} mm from the tip, more than the tool's {1e3 * longest:.0f} mm",
                "make the path smaller, bring it nearer to the trocar, or lengthen the tool",
            )
        raise UnreachableError(
            "path",
            places.arc[k],
            f"the tip is {1e3 * depth[k]:.1f} mm from the trocar, where the shaft has no direction",
            f"keep the path {1e3 * _SHALLOWEST_M:.0f} mm or more away from it",
        )


def _follow(robot: RobotModel, q: Array, places: _Places, reference: Reference, *, as_given: bool) -> Reach:
    count = len(places.t)
    poses, shares = np.empty((count, robot.n)), np.empty(count)
    worst: tuple[int, Array] | None = None
    for k in range(count):
        span = robot.state(q).tool_span
        wrist, wrist_velocity = desired_wrist(
            places.tip[k], places.tip_velocity[k], places.trocar[k], places.trocar_velocity[k], span
        )
        placed = solve_pose(robot, q, places.tip[k], wrist)
        if not placed.found:
            raise _out_of_reach(robot, places, k, wrist, placed)
        q = poses[k] = placed.q
        velocity = np.concatenate([places.tip_velocity[k], wrist_velocity])
        rates = _least_share(robot, robot.state(q).A, velocity)
        shares[k] = float(np.abs(rates / robot.v_max).max())
        if shares[k] > max(1.0, shares[:k].max(initial=0.0)):
            worst = k, rates
    if worst is not None:
        raise _too_fast(robot, places, *worst, reference)
    margin = np.minimum(poses - robot.q_min, robot.q_max - poses).min(axis=1)
    return Reach(places.t, places.arc, poses, shares, margin, as_given)


def _out_of_reach(robot: RobotModel, places: _Places, k: int, wrist: Array, placed: Placed) -> UnreachableError:
    names = [robot.data.joint_names[i] for i in placed.at_limit]
    field = "joint limits" if names else ("trocar" if k == 0 else "path")
    stuck = f", with {', '.join(names)} at the limit" if names else ""
    return UnreachableError(
        field,
        places.arc[k],
        f"no pose has the tip at {np.round(places.tip[k], 4).tolist()} m and the wrist at "
        f"{np.round(wrist, 4).tolist()} m, on the line through the trocar; the arm stays "
        f"{1e3 * placed.miss_m:.1f} mm away{stuck}",
        "make the path smaller, move it or the trocar towards the arm, or begin with another swivel",
    )


def _too_fast(robot: RobotModel, places: _Places, k: int, rates: Array, reference: Reference) -> UnreachableError:
    shares = np.abs(rates / robot.v_max)
    i = int(np.argmax(shares))
    # Joint speeds go with the tip's, which may peak below v_max where the acceleration is what limits it.
    peak = float(np.linalg.norm(places.tip_velocity, axis=1).max())
    return UnreachableError(
        "v_max",
        places.arc[k],
        f"{robot.data.joint_names[i]} would have to turn at {abs(rates[i]):.2f} rad/s and can do {robot.v_max[i]:.2f}",
        f"lower v_max from {reference.v_max:g} to {0.99 * peak / shares[i]:.3g} m/s or less, or move the path away "
        "from the trocar",
    )


def _least_share(robot: RobotModel, a: Array, velocity: Array) -> Array:
    """Return the joint velocity (n,) for tip and wrist velocity (6,) that needs the smallest share of the speed limits.

    The smallest one by length is nearly always good enough; where it is not, the self-motion that brings the
    largest share down is found by a linear program.
    """
    left, values, right = np.linalg.svd(a)
    rank = int((values > 1e-9 * values[0]).sum())
    shortest: Array = right[:rank].T @ ((left[:, :rank].T @ velocity) / values[:rank])
    if float(np.abs(shortest / robot.v_max).max()) <= 1.0 or rank == robot.n:
        return shortest
    from scipy.optimize import linprog  # late: slow to import, and rarely needed

    free = right[rank:].T / robot.v_max[:, None]
    base = shortest / robot.v_max
    ones = np.ones((robot.n, 1))
    found = linprog(
        c=[*([0.0] * free.shape[1]), 1.0], A_ub=np.block([[free, -ones], [-free, -ones]]),
        b_ub=np.concatenate([-base, base]), bounds=[(None, None)] * (free.shape[1] + 1),
    )  # fmt: skip
    return shortest if found.x is None else shortest + right[rank:].T @ found.x[:-1]


def _middle(robot: RobotModel, q: Array) -> Array | None:
    """Choose the pose of the feasible self-motion that is farthest from all joint limits; None where none can be found.

    A joint that the self-motion does not move has the same room at each of them, and may have the least: many poses
    would be equal to rounding. So the joints that it moves decide.
    """
    try:
        poses = self_motion(robot, q).q
    except RobotError:
        return None  # a singular start, or one outside the limits: there is nothing to choose from
    moved = np.ptp(poses, axis=0) > 1e-6
    room = np.minimum(poses - robot.q_min, robot.q_max - poses)[:, moved].min(axis=1, initial=np.inf)
    return np.array(poses[int(np.argmax(room))])
