"""Step one of the operative procedure: a hand guides the tip to the incision, and the trocar is registered there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from moc_opt.arrays import Array
from moc_opt.control.hand_guiding import HandGuiding
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import MocOptError, PlantError, TaskError
from moc_opt.inputs.settings import Settings
from moc_opt.robots.inverse_kinematics import pose_with_tip
from moc_opt.robots.model import RobotModel, RobotState
from moc_opt.sim.loop import ClosedLoop
from moc_opt.sim.plant import Plant, Stop
from moc_opt.trace.trace import Trace

_NO_REFERENCE, _NO_TROCAR = np.zeros((3, 3)), np.zeros((2, 3))
_SPEED_FILTER_Hz = 5.0  # the encoders' noise alone is some mm/s at the tip


class HandSettings(Settings):
    """How the hand pulls.

    Raises:
        PlantError: a value is out of range.
        UnknownNameError: a field does not exist.
    """

    KIND: ClassVar[str] = "[hand]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

    stiffness_N_per_m: float = Field(600.0, gt=0.0, le=1e4)
    damping_Ns_per_m: float = Field(60.0, gt=0.0, le=1e3)
    force_max_N: float = Field(15.0, gt=0.0, le=200.0, description="it never pulls harder")
    speed_max_m_per_s: float = Field(0.15, gt=0.0, le=1.0, description="it does not want to go faster")
    correction_per_s: float = Field(
        2.0, ge=0.0, le=20.0, description="how fast it pulls harder where that was too little"
    )
    content_m: float = Field(0.0005, ge=0.0, le=0.05, description="nearer than this it corrects no more")


class HandsOnSettings(Settings):
    """The guiding, and when the trocar counts as registered.

    Raises:
        TaskError: a value is out of range.
        UnknownNameError: a field does not exist.
    """

    KIND: ClassVar[str] = "[hands_on]"
    ERROR: ClassVar[type[MocOptError]] = TaskError

    joint_damping_Nm_s_per_rad: float = Field(3.0, ge=0.0, le=100.0)
    registration_error_m: float = Field(
        0.001, ge=0.0, le=0.005, description="added to what the kinematics say, in a seeded direction"
    )
    tolerance_m: float = Field(0.002, gt=0.0, le=0.05, description="the tip is at the incision when this near")
    rest_speed_m_per_s: float = Field(0.003, gt=0.0, le=0.1, description="a slower tip rests")
    rest_s: float = Field(0.4, gt=0.0, le=10.0, description="it has to rest this long")
    time_limit_s: float = Field(20.0, gt=0.0, le=600.0)
    distance_max_m: float = Field(0.6, gt=0.0, le=3.0, description="an incision farther from the tip is a mistake")
    hand: HandSettings = HandSettings()
    guard: SafetyFilterSettings = SafetyFilterSettings()


class HandsOnStatus(Enum):
    """How the guiding ended; the text is the cure."""

    REGISTERED = "the tip rested at the incision and the trocar is registered"
    SHORT = "the tip did not reach the incision: raise hand.force_max_N, tolerance_m or time_limit_s"
    RESTLESS = (
        "the tip reached the incision and did not rest there: raise joint_damping_Nm_s_per_rad, "
        "rest_speed_m_per_s or time_limit_s"
    )
    STOPPED = "the safety filter stopped the arm: the trace's meta[\"ended\"] says why"


@dataclass(frozen=True, eq=False, repr=False)
class HandsOn:
    """The result of the guiding."""

    status: HandsOnStatus
    trocar: Array  #: (3,) where the incision truly is [m]
    registered: Array | None  #: (3,) the registered trocar [m]; None if it was not registered
    q: Array  #: (n,) the robot's measured pose at the end [rad]
    trace: Trace  #: one row a tick; `trocar_m` and `trocar_registered_m` (NaN if there is none) are kept apart

    @property
    def error_m(self) -> float:
        """Distance of the registered trocar from the true one [m]; NaN if it was not registered."""
        return math.nan if self.registered is None else float(np.linalg.norm(self.registered - self.trocar))


class Hand:
    """A spring and a damper to the goal, with a slow correction; the force is bounded.

    force = D (desired - velocity) + f, |force| <= force_max, where desired is a velocity towards the goal,
    (stiffness/D) times the distance, cut at speed_max, and f grows by correction stiffness distance a second until
    the hand has arrived, as a person pulls harder when the tip stops short.
    """

    def __init__(self, settings: HandSettings, period_s: float) -> None:
        """Take hold; `period_s` is the time between two calls of `pull` [s]."""
        self.settings, self._period = settings, period_s
        self._extra = np.zeros(3)

    def pull(self, place: Array, velocity: Array, goal: Array) -> Array:
        """Compute the hand's force (3,) [N] on the tool, all arguments (3,) in world axes [m], [m/s].

        Raises:
            PlantError: an argument is not finite.
        """
        hand = self.settings
        way = goal - place
        distance = math.sqrt(float(way @ way))
        if not math.isfinite(distance + float(velocity @ velocity)):
            raise PlantError(f"the hand lost the tool at {place.tolist()} m: the arm ran away")
        desired = _cut(hand.stiffness_N_per_m / hand.damping_Ns_per_m * way, hand.speed_max_m_per_s)
        pull = hand.damping_Ns_per_m * (desired - velocity) + self._extra
        force = _cut(pull, hand.force_max_N)
        # More only near the goal, and not beyond what the arm has strength for, or it would overshoot by far;
        # less at any place, or a tool that comes loose would be pushed past the goal for ever.
        near = distance * hand.stiffness_N_per_m < hand.damping_Ns_per_m * hand.speed_max_m_per_s
        less = float(way @ self._extra) < 0.0
        if distance > hand.content_m and (less or (near and force is pull)):
            self._extra = self._extra + self._period * hand.correction_per_s * hand.stiffness_N_per_m * way
        return force


def _cut(vector: Array, most: float) -> Array:
    length = math.sqrt(float(vector @ vector))
    return vector if length <= most else vector * (most / length)


def guide_to(
    incision: ArrayLike, plant: Plant, robot: RobotModel, settings: HandsOnSettings | None = None, *, seed: int = 0
) -> HandsOn:
    """Let a hand pull the tip to the incision while the arm only carries its own weight.

    The hand sees where the tip truly is; the robot registers where its own kinematics put it. The plant goes on
    from where it is, and is left at the end as it then is.

    Args:
        incision: (3,) where the trocar truly is, base frame [m].
        plant: the simulated arm, reset to its start.
        robot: the robot's own model.
        seed: of the registration error.

    Raises:
        TaskError: the incision is no point, too far away, or out of the arm's reach; nothing has moved then.
        PlantError: the arm ran away.
    """
    settings = settings or HandsOnSettings()
    goal = np.asarray(incision, dtype=np.float64)
    if goal.shape != (3,) or not np.isfinite(goal).all():
        raise TaskError(f"incision = {incision!r}: give three finite numbers [m]")
    away = float(np.linalg.norm(goal - plant.tip))
    if away > settings.distance_max_m:
        raise TaskError(
            f"incision = {np.round(goal, 4).tolist()} m is {away:.2f} m from the tip: give one nearer than "
            f"distance_max_m = {settings.distance_max_m:g} m, or start the arm nearer to it"
        )
    pose_with_tip(robot, plant.measure().q, goal)
    columns, tips, status, q, reason = _guide(goal, plant, robot, settings)
    registered = None
    if status is HandsOnStatus.REGISTERED:
        direction = np.random.default_rng(seed).standard_normal(3)
        registered = tips.mean(axis=0) + settings.registration_error_m * direction / np.linalg.norm(direction)
        registered.setflags(write=False)
    believed = np.full(3, np.nan) if registered is None else registered
    ticks = len(columns["t_s"])
    columns["trocar_m"] = columns["tip_ref_m"] = np.tile(goal, (ticks, 1))
    columns["trocar_registered_m"] = np.tile(believed, (ticks, 1))
    columns["tip_error_m"] = np.linalg.norm(columns["tip_ref_m"] - columns["tip_m"], axis=1)
    meta = {
        "hands_on": settings.model_dump(mode="json"), "status": status.name.lower(), "seed": seed,
        "ended": f"stopped: {reason}" if reason else "completed",
    }  # fmt: skip
    return HandsOn(status, goal, registered, q, Trace(columns, {**meta, "period_s": plant.settings.period_s}))


class _Guiding:
    """Hand guiding with the interface of a filtered controller; it has no reference.

    ``seen`` is the state at the last measurement that was believed. The filter is not shown it: it would take the
    hand's force for a motion that no torque explains.
    """

    def __init__(self, law: HandGuiding, robot: RobotModel) -> None:
        self._law, self._robot = law, robot

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Take the first state; the law itself has no memory."""
        self.seen: RobotState = self._robot.state(q, v)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] that carries the arm's weight and damps its joints."""
        self.seen = self._robot.state(q, v)
        return self._law.tick(self.seen)

    def set_applied_torque(self, tau: Array) -> None:
        """Do nothing: the law has no memory."""


def _guide(
    goal: Array, plant: Plant, robot: RobotModel, settings: HandsOnSettings
) -> tuple[dict[str, Array], Array, HandsOnStatus, Array, str]:
    period, guard = plant.settings.period_s, settings.guard
    law = _Guiding(HandGuiding(robot, settings.joint_damping_Nm_s_per_rad), robot)
    # The arm is in no incision yet, and a hand of unknown force pulls it.
    safety_filter = SafetyFilter(robot, guard, period, incision=False, momentum=False)
    loop = ClosedLoop(plant, law, safety_filter, Stop(guard.stop_damping_Nm_s_per_rad, guard.stop_s))
    hand, tool, tip = Hand(settings.hand, period), plant.mj_data.body("tool"), plant.mj_data.body(robot.data.tip_frame)
    point = tool.xmat.reshape(3, 3).T @ (tip.xpos - tool.xpos)  # where the hand holds the tool, in its own frame [m]
    gain = -math.expm1(-2.0 * math.pi * _SPEED_FILTER_Hz * period)
    needed = max(1, round(settings.rest_s / period))
    slow, reached = np.zeros(3), False
    rows: list[dict[str, Array | float]] = []
    resting: list[Array] = []
    ticks = math.ceil(settings.time_limit_s / period)
    loop.start(_NO_REFERENCE, _NO_TROCAR)
    while len(resting) < needed and loop.ticks < ticks and not loop.finished:
        # The model has the plant's geometry, and differs in masses only: this is the tip's true velocity.
        force = hand.pull(plant.tip, robot.state(plant.q, plant.v).J_tip @ plant.v, goal)
        plant.push("tool", force, point)
        rows.append({
            "t_s": plant.time, "q_rad": plant.q, "v_rad_per_s": plant.v, "tip_m": plant.tip, "wrist_m": plant.wrist,
            "hand_force_N": force,
        })  # fmt: skip
        there = float(np.linalg.norm(plant.tip - goal)) <= settings.tolerance_m
        loop.step(_NO_REFERENCE, _NO_TROCAR)
        rows[-1]["tau_Nm"] = loop.tau
        seen = law.seen
        slow += gain * (seen.J_tip @ seen.v - slow)
        reached = reached or there
        if there and not loop.stop_reason and float(np.linalg.norm(slow)) <= settings.rest_speed_m_per_s:
            resting.append(seen.tip)
        else:
            resting.clear()
    plant.clear_pushes("tool")
    status = HandsOnStatus.REGISTERED
    if loop.stop_reason:
        status = HandsOnStatus.STOPPED
    elif len(resting) < needed:
        status = HandsOnStatus.RESTLESS if reached else HandsOnStatus.SHORT
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return columns, np.array(resting), status, np.array(law.seen.q), loop.stop_reason
