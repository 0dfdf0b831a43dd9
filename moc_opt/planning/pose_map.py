"""Map the poses of an arm at each point of a path, with mu and the distance to joint limits.

If the axes meet in a shoulder, an elbow and a wrist, the poses have a closed form in the swivel: the angle of the elbow
about the line shoulder-wrist (Kreutz-Delgado, Long and Seraji 1992). For any other arm, curves of poses are traced
numerically. With a null space of several dimensions, the curves contain only some of the poses.
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import RobotError, shown
from moc_opt.planning.course import Margin, Targets
from moc_opt.planning.elbow import Elbow, wrapped
from moc_opt.planning.self_motion import curve_through
from moc_opt.robots.inverse_kinematics import solve_pose
from moc_opt.robots.model import RobotModel, link_frames

Flags = NDArray[np.bool_]

EXACT_M = 1e-7  #: Distance up to which two axes count as meeting.
BRANCHES = 8  #: Poses per swivel. Bits 0, 1, 2 of a pose's branch index are 1 if t2, t4, t6 of `ClosedForm` are < 0.
STRAIGHT = 1e-9  #: Sine of the angle between forearm and line shoulder-wrist. Below it, the map has no pose.
ROUNDING_RAD = 1e-9  #: Tolerance of the joint limits.
SWIVELS, MOST_SWIVELS = 720, 2880  #: Default and largest number of swivels.
PEAKS = 4  #: Largest number of local maxima in `PoseMap.peaks`.
STEP_RAD = 0.03  #: Spacing of the samples along a traced curve.
SEEDS = 64  #: Random starts of inverse kinematics at the first time. Each later time has a sixteenth as many.
MOST_CURVES = 16  #: Largest number of curves at one time.
SAME_CURVE = 0.7  #: A pose is on a known curve if it is nearer to a sample than this share of the spacing.
NO_LIMIT_RAD = 20.0  #: See `without_limits`.
REACHED_M = 1e-9  #: Error of tip and wrist below which `reach` accepts a pose.
SCANNED, SCANS = "scanned, all branches", 360  #: Name of `largest_mu`'s closed-form method, and its number of swivels.
STARTS, LATER = 96, 12  #: Random starts of `largest_mu` at the first point, and at each later point.
KEPT = 6  #: Largest number of maxima that a point hands on to its neighbours.
SAME = 1e-5  #: Relative difference of mu up to which two maxima count as one.


@dataclass(frozen=True, eq=False)
class PoseMap:
    """Poses at k times on b branches, with m swivels each; NaN means no pose.

    If the poses lie on traced curves, b is 1 and m counts the samples along the curves.
    """

    robot: RobotModel
    targets: Targets
    q_rad: Array  #: (k,b,m,n)
    mu: Array  #: (k,b,m) [m^3], also beyond joint limits
    room_rad: Array  #: (k,b,m) smallest distance of a joint from its limits, negative beyond a limit
    closed: ClosedForm | None = None  #: normal form of the arm, None if the curves are traced

    def feasible(self, margin: Margin = 0.0) -> Flags:
        """Return flags (k,b,m): whether every joint keeps the margin from its limits."""
        room = self.room_rad - margin if np.ndim(margin) == 0 else _room(self.robot, self.q_rad, margin)
        return np.asarray(room >= -ROUNDING_RAD)

    def crossing(self, k: int, step_rad: Array) -> NDArray[np.int64]:
        """Return a bit mask for each swivel (m,): the bits of the branch index that a step (n,) at time k can flip."""
        if self.closed is None:
            return np.zeros(self.mu.shape[2], dtype=np.int64)
        with np.errstate(invalid="ignore"):
            signs = np.abs(np.sin(self.q_rad[k, 0, :, 1:6:2] + self.closed.offset[1::2]))
            near = signs <= np.sin(np.minimum(2.0 * step_rad[1:6:2], 0.5 * np.pi))
        return near @ np.array([1, 2, 4])

    def peaks(self, k: int) -> Array:
        """Return the feasible poses (p,n) at the highest local maxima of mu at time k."""
        may = self.room_rad[k] >= -ROUNDING_RAD
        score = np.where(may, self.mu[k], -np.inf).max(axis=0)
        peak = (score >= np.roll(score, 1)) & (score >= np.roll(score, -1)) & np.isfinite(score)
        chosen = np.argsort(np.where(peak, -score, np.inf))[: min(PEAKS, int(peak.sum()))]
        return np.asarray(self.q_rad[k][:, chosen][may[:, chosen]])


def map_of(robot: RobotModel, q_start: Array, targets: Targets, swivels: int = SWIVELS) -> PoseMap:
    """Make the map, in closed form if the arm has one, else by tracing.

    Args:
        q_start: (n,) [rad] a pose for the first target.
        swivels: number of swivels, 8 to `MOST_SWIVELS`. Above `SWIVELS`, traced curves become finer.
    """
    if not isinstance(swivels, numbers.Integral) or not 8 <= int(swivels) <= MOST_SWIVELS:
        raise RobotError(f"swivels = {shown(swivels)}: give a whole number from 8 to {MOST_SWIVELS}")
    arm = closed_form(robot)
    if arm is None:
        return _traced(robot, targets, q_start, STEP_RAD * min(1.0, SWIVELS / swivels))
    elbow = Elbow(robot, targets.wrist)
    first = float(np.mod(elbow.swivel(q_start[None])[0] + np.pi, 2.0 * np.pi / swivels)) - np.pi
    swivel = first + 2.0 * np.pi * np.arange(swivels) / swivels
    return _closed(robot, arm._replace(swivel_rad=swivel, reference=elbow.reference), targets, float(q_start[6]))


class ClosedForm(NamedTuple):
    """Normal form: the last link's rotation is R_0 Rz(t1) Ry(t2) Rz(t3) Ry(t4) Rz(t5) Ry(t6) Rz(t7), t = q + offset."""

    base: Array  #: R_0 (3,3), rotation from the normal form's axes to the world
    shoulder: Array  #: (3,) [m]
    upper: float  #: Shoulder to elbow along axis 3, signed [m].
    fore: float  #: Elbow to wrist along axis 5, signed [m].
    tool: float  #: Wrist to tip along axis 7, signed [m].
    offset: Array  #: (6,) [rad] for the first six joints
    swivel_rad: Array = np.empty(0)  #: (m,) evenly over one turn
    reference: Array = np.array([0.0, 0.0, 1.0])  #: (3,) direction of the elbow at swivel zero


def closed_form(robot: RobotModel) -> ClosedForm | None:
    """Return the normal form of an arm; None if it has none, or if a joint's range exceeds one turn."""
    chain = robot.chain
    if robot.n != 7 or chain.prismatic.any():
        return None
    origins, rotations = (frames[0] for frames in link_frames(robot, np.zeros((1, 7))))
    axes = np.einsum("jab,jb->ja", rotations, chain.axes)
    if np.abs((axes[:-1] * axes[1:]).sum(axis=1)).max() > EXACT_M:
        return None
    tip, wrist = (origins[6] + rotations[6] @ offset for offset in chain.offsets)
    # the points of axes 1, 3 and 5 that are nearest to the next axis
    shoulder, elbow, center = (origins[j] + axes[j] * ((origins[j + 1] - origins[j]) @ axes[j]) for j in (0, 2, 4))
    through = [(shoulder, 1), (shoulder, 2), (elbow, 3), (elbow, 4), (center, 5), (center, 6), (tip, 6)]
    off = [np.linalg.norm(np.cross(point - origins[j], axes[j])) for point, j in through]
    upper, fore = float((elbow - shoulder) @ axes[2]), float((center - elbow) @ axes[4])
    whole = (robot.q_max - robot.q_min)[:6].max() > 2.0 * np.pi
    if max(*off, np.linalg.norm(wrist - center)) > EXACT_M or min(abs(upper), abs(fore)) < EXACT_M or whole:
        return None
    base = np.column_stack([np.cross(axes[1], axes[0]), axes[1], axes[0]])
    offset, turned = np.zeros(6), np.array(base)
    for j in range(1, 6):
        x, y, z = turned.T @ axes[j + 1]
        offset[j] = np.arctan2(x, z) if j % 2 else np.arctan2(-x, y)
        turned = turned @ pin.exp3(offset[j] * np.eye(3)[1 if j % 2 else 2])
    return ClosedForm(base, shoulder, upper, fore, float((tip - center) @ axes[6]), offset)


def _closed(robot: RobotModel, arm: ClosedForm, targets: Targets, idle_rad: float) -> PoseMap:
    angles = np.moveaxis(_angles(arm, targets), -1, 0)
    s, e, w = (np.arange(BRANCHES) >> bit & 1 for bit in range(3))  # whether t2, t4, t6 is negative
    flips = np.stack([s, s, s ^ e, e, e ^ w, w], axis=1)
    other = np.stack([-angle if j % 2 else angle + np.pi for j, angle in enumerate(angles)])
    column = np.s_[:6, None, None]
    middle, half = 0.5 * (robot.q_max + robot.q_min)[column], 0.5 * (robot.q_max - robot.q_min)[column]
    away = [wrapped(each - arm.offset[:, None, None] - middle) for each in (angles, other)]
    joints, rooms = [middle + each for each in away], [half - np.abs(each) for each in away]
    shape = len(targets), BRANCHES, len(arm.swivel_rad)
    q, room = np.empty((*shape, 7)), np.empty(shape)
    for branch, flip in enumerate(flips):
        room[:, branch] = np.min([rooms[f][j] for j, f in enumerate(flip)], axis=0)
        for j, f in enumerate(flip):
            q[:, branch, :, j] = joints[f][j]
    q[..., 6] = np.where(np.isnan(q[..., 0]), np.nan, idle_rad)
    mu = np.broadcast_to(_mu(robot, q[:, 0])[:, None], room.shape)
    return PoseMap(robot, targets, q, mu, room, arm)


def _mu(robot: RobotModel, q: Array) -> Array:
    known = np.isfinite(q[..., 0])
    mu = np.full(known.shape, np.nan)
    mu[known] = robot.mu_along(q[known])
    return mu


def _room(robot: RobotModel, q: Array, margin: Margin = 0.0) -> Array:
    room = np.minimum(q - robot.q_min, robot.q_max - q) - margin
    return np.asarray(room[..., robot.moves.any(axis=0)].min(axis=-1))


def _angles(arm: ClosedForm, targets: Targets) -> Array:
    way = (targets.wrist - arm.shoulder) @ arm.base
    span = np.linalg.norm(way, axis=1, keepdims=True)
    line, reference = way / span, arm.reference @ arm.base
    side = np.cross(line, reference)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    along = (arm.upper**2 + span**2 - arm.fore**2) / (2.0 * span)
    square = arm.upper**2 - along**2
    radius = np.sqrt(np.where(square > (STRAIGHT * arm.fore) ** 2, square, np.nan))
    c, s = np.cos(arm.swivel_rad)[:, None], np.sin(arm.swivel_rad)[:, None]
    elbow = (along * line)[:, None] + radius[:, None] * (c * np.cross(side, line)[:, None] + s * side[:, None])
    u = (((targets.tip - targets.wrist) @ arm.base) / arm.tool)[:, None]
    a3, a5 = elbow / arm.upper, (way[:, None] - elbow) / arm.fore
    flat = np.hypot(a3[..., 0], a3[..., 1])
    found = np.empty((*flat.shape, 6))
    found[..., 0] = np.arctan2(a3[..., 1], a3[..., 0])
    found[..., 1] = np.arctan2(flat, a3[..., 2])
    a2 = np.stack([-np.sin(found[..., 0]), np.cos(found[..., 0]), np.zeros_like(flat)], axis=-1)
    found[..., 2] = np.arctan2(_dot(a2, a5), _dot(np.cross(a2, a3), a5))
    a4 = np.cross(a3, a5)
    sine = np.linalg.norm(a4, axis=-1)
    a4 /= sine[..., None]
    found[..., 3] = np.arctan2(sine, _dot(a3, a5))
    x, y = _dot(np.cross(a4, a5), u), _dot(a4, u)
    found[..., 4] = np.arctan2(y, x)
    found[..., 5] = np.arctan2(np.hypot(x, y), _dot(a5, u))
    return found


def _dot(one: Array, two: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", one, two))


def reach(robot: RobotModel, q: Array, tip: Array, wrist: Array) -> Array | None:
    """Find a pose near q with the given tip and wrist, ignoring joint limits; None if none is found."""
    placed = solve_pose(robot, q, tip, wrist, iterations=30, limited=False)
    return placed.q if placed.miss_m < REACHED_M else None


def without_limits(robot: RobotModel) -> RobotModel:
    """Return a copy of the arm whose revolute joints can turn by `NO_LIMIT_RAD` to both sides."""
    slides, data = robot.chain.prismatic, robot.data
    low, high = np.where(slides, data.q_min, -NO_LIMIT_RAD), np.where(slides, data.q_max, NO_LIMIT_RAD)
    return RobotModel(replace(data, q_min=low, q_max=high))


def nearest_turns(robot: RobotModel, q: Array) -> Array:
    """Shift revolute joints by whole turns to the angles nearest to the middle of their range."""
    turns = np.round((q - 0.5 * (robot.q_min + robot.q_max)) / (2.0 * np.pi))
    return q - 2.0 * np.pi * np.where(robot.chain.prismatic, 0.0, turns)


def _traced(robot: RobotModel, targets: Targets, q_start: Array, step_rad: float) -> PoseMap:
    free, moving, rng = without_limits(robot), np.asarray(robot.moves.any(axis=0)), np.random.default_rng(0)
    columns: list[list[Array]] = []

    def near(curve: Array, pose: Array) -> bool:
        return bool(np.linalg.norm(wrapped(curve - pose)[:, moving], axis=1).min() < SAME_CURVE * step_rad)

    for k in range(len(targets)):
        tip, wrist = targets.tip[k], targets.wrist[k]
        if k and max(np.abs(tip - targets.tip[k - 1]).max(), np.abs(wrist - targets.wrist[k - 1]).max()) < 1e-12:
            columns.append(columns[-1])
            continue
        guesses = [curve[i * len(curve) // 3] for curve in columns[-1] for i in range(3)] if k else [q_start]
        poses = [reach(free, guess, tip, wrist) for guess in guesses]
        for _ in range(SEEDS // 16 if k else SEEDS):
            placed = solve_pose(robot, np.where(moving, rng.uniform(robot.q_min, robot.q_max), q_start), tip, wrist)
            poses.append(placed.q if placed.found else None)
        found: list[Array] = []
        for pose in poses:
            if pose is None or len(found) >= MOST_CURVES or any(near(curve, pose) for curve in found):
                continue
            traced = curve_through(free, pose, step_rad)
            if traced is not None:
                found.append(traced.q)
        columns.append(found)
    longest = max(1, *(sum(len(curve) + 1 for curve in column) for column in columns))
    q = np.full((len(columns), 1, longest, robot.n), np.nan)  # curve after curve, separated by a NaN
    for k, column in enumerate(columns):
        at = 0
        for curve in column:
            q[k, 0, at : at + len(curve)] = nearest_turns(robot, curve)
            at += len(curve) + 1
    return PoseMap(robot, targets, q, _mu(robot, q), _room(robot, q))


class Largest(NamedTuple):
    """The largest mu at k points."""

    mu: Array  #: (k,) [m^3]
    method: str  #: `SCANNED`, or "best found of N starts".


def largest_mu(robot: RobotModel, poses: Array) -> Largest:
    """Find for each pose (k, n) the largest mu with the same tip and wrist.

    The poses should follow a path, because each point hands its maxima on to its neighbours.
    """
    inside = np.clip(poses, robot.q_min, robot.q_max)
    count, tips, wrists = len(inside), *robot.tool_along(inside)
    targets, best = np.stack([tips, wrists], axis=1), np.empty(count)
    if closed_form(robot) is not None:
        at, zeros = np.arange(float(count + 1)), np.zeros(count + 1)
        rows = np.minimum(at, count - 1).astype(int)  # a map needs two points or more
        found, method = map_of(robot, inside[0], Targets(at, tips[rows], wrists[rows], zeros), SCANS), SCANNED
        for k in range(count):
            _, best[k] = _climbed(robot, targets[k], found.peaks(k))
    else:
        rng = np.random.default_rng(0)
        kept: list[Array] = [np.empty((0, robot.n))] * count
        for k, q in enumerate(inside):
            drawn = rng.uniform(robot.q_min, robot.q_max, (LATER if k else STARTS, robot.n))
            kept[k], best[k] = _climbed(robot, targets[k], np.vstack([q[None], kept[k - 1], drawn]))
        for k in range(count - 2, -1, -1):
            kept[k], best[k] = _climbed(robot, targets[k], np.vstack([kept[k], kept[k + 1]]))
        method = f"best found of {STARTS + (count - 1) * LATER} starts"
    return Largest(np.fmax(best, robot.mu_along(inside)), method)


def _climbed(robot: RobotModel, target: Array, starts: Array) -> tuple[Array, float]:
    starts = np.clip(starts, robot.q_min, robot.q_max)
    mus, target = np.empty(len(starts)), np.ascontiguousarray(target)
    robot.arm.ascend(np.array(robot.q_min), np.array(robot.q_max), target, starts, mus)
    chosen: list[int] = []
    for i in (int(i) for i in np.argsort(-mus) if mus[i] > 0.0):
        if len(chosen) < KEPT and all(mus[j] - mus[i] > SAME * mus[j] for j in chosen):
            chosen.append(i)
    return starts[chosen], float(mus.max(initial=-1.0))
