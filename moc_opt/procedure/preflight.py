"""Checks before anything moves (limits and rank at the start, reach along the whole path), and random starts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import RobotError, ScenarioError
from moc_opt.model.robot_model import RobotModel, RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.procedure.reachability import Reach, UnreachableError, check_reachable
from moc_opt.redundancy.freedoms import freedoms
from moc_opt.tasks import Reference, Trocar

Found = TypeVar("Found")

SINGULAR = (1e-4, 1e-4)
"""Least `Freedoms.tip` and `Freedoms.both`."""
REGULAR = (0.1, 0.05)
"""The same at a random start and along the path from it. The home pose of the LWR4+ has 0.41 and 0.14."""
DRAWN_MARGIN = 0.1
"""Share of each joint's range that a random start keeps from both limits before its swivel is chosen."""
DRAWS = 200
"""Poses that are tried for a random start."""
SPACING_M = 0.005
"""Distance between the points at which the path is checked [m]."""


def check_start(robot: RobotModel, q: ArrayLike) -> RobotState:
    """Check that a run can begin at q (n,) [rad], and return the state there.

    Raises:
        ScenarioError: wrong shape, not finite, outside the joint limits, or singular: the tip cannot move in some
            direction, or tip and wrist cannot move together as they can elsewhere.
    """
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
            f"arm there, leave q_rad out for the home pose {np.round(robot.data.q_home, 4).tolist()}, or take "
            "pose = 'random'"
        )
    return state


def check_path(
    robot: RobotModel, q: ArrayLike, reference: Reference, registered: Trocar, until_s: float = np.inf
) -> Reach:
    """Check that the tip can follow the reference from q with the shaft through the registered trocar.

    Args:
        q: (n,) the start [rad].
        registered: the trocar that the controller is told.
        until_s: end of the run [s]; the reference after it is ignored.

    Raises:
        UnreachableError: a point or a joint speed is out of reach; names what, where and the cure.
    """
    try:
        return check_reachable(robot, q, reference, registered, spacing_m=SPACING_M, until_s=until_s)
    except UnreachableError as error:
        error.args = (f"[task] {error}; [start] check_path = false leaves this check out",)
        raise


def random_start(
    robot: RobotModel, rng: np.random.Generator, swivelled: Callable[[Array], Array],
    lay_out: Callable[[Array], tuple[Found, Reach]], margins: Array,
) -> Found:  # fmt: skip
    """Draw poses until one can do the task, and return what was laid out from it.

    A pose is drawn evenly from the joints' ranges, less `DRAWN_MARGIN` at both ends, and rejected where, after its
    swivel is chosen,

    - it is singular or nearly so (`REGULAR`), or a pose along the path is;
    - a joint is within its margin of its limit, at the start or along the path;
    - tip or wrist is below the plane that the arm stands on, at the start or along the path;
    - the task cannot be done from it within joint limits and joint speeds.

    Args:
        swivelled: a pose -> the one that is begun with, of the same tip and wrist.
        lay_out: a pose -> the task from there, and how it is followed.
        margins: (n,) that the joints keep from their limits [rad], [m] where they slide.

    Raises:
        ScenarioError: none of `DRAWS` poses passes; says what rejected how many.
        MocOptError: the task is wrong from every pose.
    """
    room = DRAWN_MARGIN * (robot.q_max - robot.q_min)
    rejected: Counter[str] = Counter()
    for _ in range(DRAWS):
        drawn = rng.uniform(robot.q_min + room, robot.q_max - room)
        # The swivel is a scan of milliseconds, and neither tip nor wrist depends on it.
        reason = _unfit(robot, drawn, margins)
        if not reason:
            try:
                q = swivelled(drawn)
            except RobotError:
                reason = "singular"
            else:
                reason = _unfit(robot, q, margins)
        if not reason:
            try:
                found, reach = lay_out(q)
            except UnreachableError as error:
                reason = f"the task is out of reach ({error.field})"
            else:
                reason = next(filter(None, (_unfit(robot, pose, margins) for pose in reach.q_rad)), "")
                if not reason:
                    return found
                reason += " along the path"
        rejected[reason] += 1
    counts = ", ".join(f"{reason} {count}" for reason, count in rejected.most_common())
    raise ScenarioError(
        f"[start] pose = 'random': none of {DRAWS} poses can do the task; rejected: {counts}; make the [task] smaller "
        "or slower, change [trocar] depth_m, lower [start] limit_margin_rad, or take pose = 'home'"
    )


def _unfit(robot: RobotModel, q: Array, margins: Array) -> str:
    """Return why a random start is rejected without a look at the task; "" where it is not."""
    left, state = freedoms(robot, q), robot.state(q)
    if left.tip < REGULAR[0] or left.both < REGULAR[1]:
        return "singular"
    if (np.minimum(q - robot.q_min, robot.q_max - q) < margins).any():
        return "joint limits"
    if min(state.tip[2], state.wrist[2]) < 0.0:
        return "below the arm's base"
    return ""
