"""Checks of the start and the path before a run, and random starts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import RobotError, ScenarioError, TaskError
from moc_opt.planning.self_motion import freedoms, self_motion
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.inverse_kinematics import Placed, solve_pose
from moc_opt.robots.model import RobotModel, RobotState
from moc_opt.tasks import Reference, Trocar

Found = TypeVar("Found")

SINGULAR = (1e-4, 1e-4)
"""Lower bounds at every start on `Freedoms.tip` and `Freedoms.both` of planning/self_motion.py: the ratios of the
smallest to the largest singular value of J_tip, and of the fifth to the largest one of A = [J_tip; J_wrist]."""
REGULAR = (0.1, 0.05)
"""Like `SINGULAR`, but for a random start and for the poses along its path."""
DRAWN_MARGIN = 0.1  #: Smallest distance of a drawn pose from the joint limits [share of the range].
DRAWS = 200  #: Largest number of poses drawn for a random start.
SPACING_M = 0.005  #: Distance between checked points of the path [m].
_TIMES = 1500  # samples of the path, from which the checked points are chosen
_SHALLOWEST_M = 0.002  # smallest distance from tip to trocar [m]
_START_TOLERANCE_M = 0.002  # largest distance from the start pose's tip to the start of the reference [m]


class UnreachableError(TaskError):
    """The arm cannot do this task. `field` names the cause, and `arc_length_m` the place on the path."""

    def __init__(self, field: str, arc_length_m: float, problem: str, cure: str) -> None:
        super().__init__(f"{1e3 * arc_length_m:.1f} mm along the path: {problem}; {cure}")
        self.field, self.arc_length_m = field, arc_length_m


def check_start(robot: RobotModel, q: ArrayLike) -> RobotState:
    """Return the state at q (n,) [rad]. Raise a ScenarioError if no run can begin there."""
    pose = np.asarray(q, dtype=np.float64)
    if pose.shape != (robot.n,) or not np.isfinite(pose).all():
        raise ScenarioError(f"[start] q_rad = {pose.tolist()}: give {robot.n} finite numbers [rad]")
    outside = np.flatnonzero((pose < robot.q_min - 1e-9) | (pose > robot.q_max + 1e-9))
    if outside.size:
        i = int(outside[0])
        raise ScenarioError(
            f"[start] q_rad: joint {i + 1} = {pose[i]:.6g} rad is outside the limits of "
            f"{robot.data.joint_names[i]!r}: choose {robot.q_min[i]:.6g} to {robot.q_max[i]:.6g}"
        )
    state = robot.state(pose)
    left = freedoms(robot, pose)
    lost = left.tip < SINGULAR[0]
    if lost or left.both < SINGULAR[1]:
        what = "the tip cannot move in every direction" if lost else "the tool cannot be turned in every direction"
        raise ScenarioError(
            f"[start] q_rad = {np.round(pose, 4).tolist()} is singular (mu = {state.mu:.2g} m^3): {what}; bend the "
            f"arm, omit q_rad to start at the home pose {np.round(robot.data.q_home, 4).tolist()}, or use "
            "pose = 'random'"
        )
    return state


def random_start(
    robot: RobotModel, rng: np.random.Generator, swivelled: Callable[[Array], Array],
    attempt: Callable[[Array], tuple[Found, Array]], margins: Array,
) -> Found:  # fmt: skip
    """Draw start poses until the arm can do the task, and return the task laid out from there.

    Args:
        swivelled: function that moves the elbow of a drawn pose (n,) to the place that [start] swivel sets.
        attempt: function from a start pose (n,) to the task and poses (k, n) along the path.
        margins: (n,) required distance from the joint limits, at the start and along the path [rad, m].

    Raises:
        ScenarioError: all `DRAWS` draws are rejected.
    """
    room = DRAWN_MARGIN * (robot.q_max - robot.q_min)
    rejected: Counter[str] = Counter()
    for _ in range(DRAWS):
        drawn = rng.uniform(robot.q_min + room, robot.q_max - room)
        try:
            _require_fit(robot, drawn, margins)
            q = swivelled(drawn)
            _require_fit(robot, q, margins)
            found, poses = attempt(q)
            for pose in poses:
                _require_fit(robot, pose, margins, " along the path")
            return found
        except _UnfitError as error:
            rejected[str(error)] += 1
        except UnreachableError as error:
            rejected[f"unable to do the task because of {error.field}"] += 1
        except RobotError:
            rejected["singular"] += 1
    counts = ", ".join(f"{count} {reason}" for reason, count in rejected.most_common())
    raise ScenarioError(
        f"[start] pose = 'random': the arm can do the task from none of {DRAWS} poses: {counts}; make the [task] "
        "smaller or slower, change [trocar] depth_m, lower [start] limit_margin_rad, or use pose = 'home'"
    )


class _UnfitError(Exception):
    pass


def _require_fit(robot: RobotModel, q: Array, margins: Array, where: str = "") -> None:
    left, state = freedoms(robot, q), robot.state(q)
    if left.tip < REGULAR[0] or left.both < REGULAR[1]:
        raise _UnfitError(f"singular{where}")
    if (np.minimum(q - robot.q_min, robot.q_max - q) < margins).any():
        raise _UnfitError(f"too near to a joint limit{where}")
    if min(state.tip[2], state.wrist[2]) < 0.0:
        raise _UnfitError(f"with tip or wrist below the arm's base{where}")


def check_reachable(
    robot: RobotModel, q_start: ArrayLike, reference: Reference, trocar: Trocar, until_s: float = np.inf
) -> Array:
    """Return poses (k, n) that follow the reference with the shaft through the trocar, within the joint limits.

    The reference must start at the tip of ``q_start`` (n,). It is checked up to the time ``until_s`` [s]. Only two
    starts are tried: ``q_start``, and the pose of its self-motion that is farthest from the joint limits. A refused
    path may thus be possible from another start.

    Raises:
        UnreachableError: the arm cannot follow the path.
    """
    state = robot.state(q_start)
    places = _places(reference, trocar, until_s)
    away = float(np.linalg.norm(state.tip - places.tip[0]))
    if away > _START_TOLERANCE_M:
        problem = f"the reference begins {1e3 * away:.1f} mm from the tip"
        raise UnreachableError("start", 0.0, problem, "begin the reference at the tip, or prepend a line from the tip")
    _check_depth(robot, places)
    try:
        return _follow(robot, state.q, places, reference)
    except UnreachableError:
        with suppress(UnreachableError, RobotError):
            return _follow(robot, _middle(robot, state.q), places, reference)
        raise  # the error from the given start pose


class _Places(NamedTuple):
    t: Array
    arc: Array
    tip: Array
    tip_velocity: Array
    trocar: Array
    trocar_velocity: Array


def _places(reference: Reference, trocar: Trocar, until_s: float) -> _Places:
    end = max(reference.t_start, min(reference.t_start + reference.duration, until_s))
    times = np.linspace(reference.t_start, end, _TIMES)
    tip, velocity = map(np.ascontiguousarray, reference.at(times)[:2])
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))))
    count = max(2, int(min(np.ceil(arc[-1] / SPACING_M) + 1, _TIMES)))
    chosen = np.unique(np.searchsorted(arc, np.linspace(0.0, arc[-1], count)).clip(0, _TIMES - 1))
    return _Places(times[chosen], arc[chosen], tip[chosen], velocity[chosen], *trocar.at(times[chosen]))


def _check_depth(robot: RobotModel, places: _Places) -> None:
    depth, longest = np.linalg.norm(places.trocar - places.tip, axis=1), robot.data.tool_length
    k = int(np.argmax((depth > longest) | (depth < _SHALLOWEST_M)))
    apart = f"tip and trocar are {1e3 * depth[k]:.1f} mm apart"
    if depth[k] > longest:
        cure = "make the path smaller, lower [trocar] depth_m, or lengthen the tool"
        raise UnreachableError("trocar", places.arc[k], f"{apart}, but the tool is {1e3 * longest:.0f} mm long", cure)
    if depth[k] < _SHALLOWEST_M:
        cure = f"keep the path at least {1e3 * _SHALLOWEST_M:.0f} mm away from the trocar"
        raise UnreachableError("path", places.arc[k], f"{apart}, too near to define the shaft's direction", cure)


def _follow(robot: RobotModel, q: Array, places: _Places, reference: Reference) -> Array:
    poses, rates = np.empty((2, len(places.t), robot.n))
    for k in range(len(places.t)):
        tip, speed, trocar, trocar_speed = (rows[k] for rows in places[2:])
        wrist, wrist_speed = desired_wrist(tip, speed, trocar, trocar_speed, robot.state(q).tool_span)
        placed = solve_pose(robot, q, tip, wrist)
        if not placed.found:
            raise _out_of_reach(robot, places, k, wrist, placed)
        q = poses[k] = placed.q
        rates[k] = _least_rates(robot, robot.state(q).A, np.concatenate([speed, wrist_speed]))
    shares = np.abs(rates / robot.v_max).max(axis=1)
    k = int(np.argmax(shares))
    if shares[k] > 1.0:
        i = int(np.argmax(np.abs(rates[k] / robot.v_max)))
        # On a short path, the tip may not reach v_max. So the tip's real speed is scaled.
        slower = 0.99 * float(np.linalg.norm(places.tip_velocity, axis=1).max()) / shares[k]
        raise UnreachableError(
            "v_max", places.arc[k],
            f"{robot.data.joint_names[i]} would have to turn at {abs(rates[k, i]):.2f} rad/s, but its limit is "
            f"{robot.v_max[i]:.2f} rad/s",
            f"lower v_max_m_per_s from {reference.v_max:g} to {slower:.3g} m/s, or move the path away from the trocar",
        )  # fmt: skip
    return poses


def _out_of_reach(robot: RobotModel, places: _Places, k: int, wrist: Array, placed: Placed) -> UnreachableError:
    names = [robot.data.joint_names[i] for i in placed.at_limit]
    field = "joint limits" if names else ("trocar" if k == 0 else "path")
    stuck = f", with {', '.join(names)} at the limit" if names else ""
    tip, at = (np.round(point, 4).tolist() for point in (places.tip[k], wrist))
    problem = (
        f"no pose was found with the tip at {tip} m and the wrist at {at} m (on the line from the tip through the "
        f"trocar): the arm misses one of these points by {1e3 * placed.miss_m:.1f} mm{stuck}"
    )
    cure = "make the path smaller, move path or trocar towards the arm, or begin with another [start] swivel"
    return UnreachableError(field, places.arc[k], problem, cure)


def _least_rates(robot: RobotModel, a: Array, velocity: Array) -> Array:
    """Solve ``a`` v = ``velocity`` for the shortest v or, if it exceeds v_max, for the least max |v| / v_max."""
    left, values, right = np.linalg.svd(a)
    rank = int((values > 1e-9 * values[0]).sum())
    shortest: Array = right[:rank].T @ ((left[:, :rank].T @ velocity) / values[:rank])
    base = shortest / robot.v_max
    if float(np.abs(base).max()) <= 1.0 or rank == robot.n:
        return shortest
    from scipy.optimize import linprog  # slow to import

    free, ones = right[rank:].T / robot.v_max[:, None], np.ones((robot.n, 1))
    found = linprog(
        c=np.eye(robot.n - rank + 1)[-1], A_ub=np.block([[free, -ones], [-free, -ones]]),
        b_ub=np.concatenate([-base, base]), bounds=(None, None),
    )  # fmt: skip
    return shortest if found.x is None else shortest + right[rank:].T @ found.x[:-1]


def _middle(robot: RobotModel, q: Array) -> Array:
    poses = self_motion(robot, q).q
    moved = np.ptp(poses, axis=0) > 1e-6
    room = np.minimum(poses - robot.q_min, robot.q_max - poses)[:, moved].min(axis=1, initial=np.inf)
    return np.array(poses[int(np.argmax(room))])
