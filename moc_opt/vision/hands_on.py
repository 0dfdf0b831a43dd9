"""Hand guiding of the tip to the incision, where the trocar is registered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from moc_opt.arrays import Array, read_only
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import PlantError, TaskError
from moc_opt.robots.inverse_kinematics import pose_with_tip
from moc_opt.robots.model import RobotModel, RobotState
from moc_opt.sim.loop import ClosedLoop
from moc_opt.sim.plant import Plant, Stop
from moc_opt.tasks.checks import vector3
from moc_opt.trace.trace import Trace
from moc_opt.vision.board import VisionSettings

_NO_REFERENCE, _NO_TROCAR = np.zeros((3, 3)), np.zeros((2, 3))
_SPEED_FILTER_Hz = 5.0  # cutoff frequency of the tip velocity's low-pass filter


class HandSettings(VisionSettings):
    """The force of the guiding hand."""

    KIND: ClassVar[str] = "[hand]"

    stiffness_N_per_m: float = Field(600.0, gt=0.0, le=1e4)
    """force per distance from the goal, for a slow tip near the goal"""
    damping_Ns_per_m: float = Field(60.0, gt=0.0, le=1e3)
    """force per difference between desired and real velocity of the tip"""
    force_max_N: float = Field(15.0, gt=0.0, le=200.0, description="largest force")
    speed_max_m_per_s: float = Field(0.15, gt=0.0, le=1.0, description="largest desired speed of the tip")
    correction_per_s: float = Field(2.0, ge=0.0, le=20.0)
    """the integral part of the force grows by this number times stiffness times distance, per second"""
    content_m: float = Field(0.0005, ge=0.0, le=0.05)
    """distance of the tip from the goal below which the integral part of the force stays constant"""


class HandsOnSettings(VisionSettings):
    """Settings of the guiding, and conditions for registering the trocar."""

    KIND: ClassVar[str] = "[hands_on]"

    joint_damping_Nm_s_per_rad: float = Field(3.0, ge=0.0, le=100.0)
    registration_error_m: float = Field(0.001, ge=0.0, le=0.005)
    """size of the error that is added to the registered trocar, in a seeded direction"""
    tolerance_m: float = Field(0.002, gt=0.0, le=0.05, description="the tip is at the incision within this distance")
    rest_speed_m_per_s: float = Field(0.003, gt=0.0, le=0.1, description="a tip rests if it is at most this fast")
    rest_s: float = Field(0.4, gt=0.0, le=10.0, description="time for which the tip must rest at the incision")
    time_limit_s: float = Field(20.0, gt=0.0, le=600.0)
    distance_max_m: float = Field(0.6, gt=0.0, le=3.0, description="largest distance from tip to incision at the start")
    hand: HandSettings = HandSettings()
    guard: SafetyFilterSettings = SafetyFilterSettings()


class HandsOnStatus(Enum):
    """How the guiding ended."""

    REGISTERED = "the tip rested at the incision and the trocar is registered"
    SHORT = "the tip did not reach the incision: raise hand.force_max_N, tolerance_m or time_limit_s"
    RESTLESS = (
        "the tip reached the incision but did not rest at it: raise joint_damping_Nm_s_per_rad, "
        "rest_speed_m_per_s or time_limit_s"
    )
    STOPPED = "the safety filter stopped the arm: the trace's meta[\"ended\"] says why"


@dataclass(frozen=True, eq=False, repr=False)
class HandsOn:
    """The result of the guiding."""

    status: HandsOnStatus
    trocar: Array  #: (3,) true position of the incision [m]
    registered: Array | None  #: (3,) [m]; None unless the status is REGISTERED
    q: Array  #: (n,) measured pose at the end [rad]
    trace: Trace  #: one row per tick

    @property
    def error_m(self) -> float:
        """Distance of the registered from the true trocar; NaN if none was registered."""
        return math.nan if self.registered is None else float(np.linalg.norm(self.registered - self.trocar))


class Hand:
    """A hand that pulls the tool to the goal like a spring and a damper.

    force = D (desired - velocity) + f, at most force_max. D is the damping. `desired` is a velocity towards the goal:
    stiffness/D * distance, at most speed_max. The integral f grows by correction * stiffness * distance per s.
    """

    def __init__(self, settings: HandSettings, period_s: float) -> None:
        self.settings, self._period, self._extra = settings, period_s, np.zeros(3)

    def pull(self, place: Array, velocity: Array, goal: Array) -> Array:
        """Return the force (3,) [N] on a tip at ``place``. Call it once per tick. PlantError: the arm ran away."""
        hand, way = self.settings, goal - place
        distance = math.sqrt(float(way @ way))
        if not math.isfinite(distance + float(velocity @ velocity)):
            raise PlantError(f"the hand lost the tool at {place.tolist()} m: the arm ran away")
        desired = _cut(hand.stiffness_N_per_m / hand.damping_Ns_per_m * way, hand.speed_max_m_per_s)
        pull = hand.damping_Ns_per_m * (desired - velocity) + self._extra
        force = _cut(pull, hand.force_max_N)
        # Far from the goal or at the force limit, the integral part only shrinks, so that the tip does not overshoot.
        near = distance * hand.stiffness_N_per_m < hand.damping_Ns_per_m * hand.speed_max_m_per_s
        less = float(way @ self._extra) < 0.0
        if distance > hand.content_m and (less or (near and force is pull)):
            self._extra = self._extra + self._period * hand.correction_per_s * hand.stiffness_N_per_m * way
        return force


def _cut(vector: Array, most: float) -> Array:
    length = math.sqrt(float(vector @ vector))
    return vector if length <= most else vector * (most / length)


class _Guiding:
    """A controller for hand guiding: gravity torque g(q) and joint damping D, tau = g(q) - D v."""

    def __init__(self, robot: RobotModel, damping_Nm_s_per_rad: float) -> None:
        self._robot, self._damping = robot, damping_Nm_s_per_rad

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        self.seen: RobotState = self._robot.state(q, v)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        self.seen = self._robot.state(q, v)
        tau = self._robot.gravity(q) - self._damping * v
        return np.clip(tau, -self._robot.tau_max, self._robot.tau_max)

    def set_applied_torque(self, tau: Array) -> None:
        """Do nothing: the law has no memory."""


def guide_to(
    incision: ArrayLike, plant: Plant, robot: RobotModel, settings: HandsOnSettings | None = None, *, seed: int = 0
) -> HandsOn:
    """Let a hand pull the tip to the incision (3,) [m], and register the trocar.

    The mean position of the resting tip in the robot's model, plus a seeded error, is registered. Raise a TaskError if
    the incision is too far away or out of reach (before the arm moves). Raise a PlantError if the arm runs away.
    """
    settings = settings or HandsOnSettings()
    goal = vector3("incision", incision)
    away = float(np.linalg.norm(goal - plant.tip))
    if away > settings.distance_max_m:
        raise TaskError(
            f"incision = {np.round(goal, 4).tolist()} m is {away:.2f} m from the tip: give one nearer than "
            f"distance_max_m = {settings.distance_max_m:g} m, or start the arm nearer to it"
        )
    pose_with_tip(robot, plant.measure().q, goal)
    period, guard = plant.settings.period_s, settings.guard
    law = _Guiding(robot, settings.joint_damping_Nm_s_per_rad)
    # The tool is in no incision yet. Momentum residuals are not checked, because the hand's force is part of them.
    safety_filter = SafetyFilter(robot, guard, period, incision=False, momentum=False)
    loop = ClosedLoop(plant, law, safety_filter, Stop(guard.stop_damping_Nm_s_per_rad, guard.stop_s))
    loop.start(_NO_REFERENCE, _NO_TROCAR)
    hand, tool, tip = Hand(settings.hand, period), plant.mj_data.body("tool"), plant.mj_data.body(robot.data.tip_frame)
    point = tool.xmat.reshape(3, 3).T @ (tip.xpos - tool.xpos)  # in the tool's frame [m]
    gain = -math.expm1(-2.0 * math.pi * _SPEED_FILTER_Hz * period)
    smoothed, reached = np.zeros(3), False
    rows: list[dict[str, Array | float]] = []
    resting: list[Array] = []  # positions of the resting tip
    needed, ticks = max(1, round(settings.rest_s / period)), math.ceil(settings.time_limit_s / period)
    while len(resting) < needed and loop.ticks < ticks and not loop.finished:
        # The model's J_tip is accurate enough for the tip's velocity.
        force = hand.pull(plant.tip, robot.state(plant.q, plant.v).J_tip @ plant.v, goal)
        plant.push("tool", force, point)
        off = float(np.linalg.norm(plant.tip - goal))
        rows.append({
            "t_s": plant.time, "q_rad": plant.q, "v_rad_per_s": plant.v, "tip_m": plant.tip, "tip_error_m": off,
            "hand_force_N": force,
        })  # fmt: skip
        there = off <= settings.tolerance_m
        loop.step(_NO_REFERENCE, _NO_TROCAR)
        rows[-1]["tau_Nm"] = loop.tau
        smoothed += gain * (law.seen.J_tip @ law.seen.v - smoothed)
        reached = reached or there
        if there and not loop.stop_reason and float(np.linalg.norm(smoothed)) <= settings.rest_speed_m_per_s:
            resting.append(law.seen.tip)
        else:
            resting.clear()
    plant.clear_pushes("tool")
    status, registered = HandsOnStatus.RESTLESS if reached else HandsOnStatus.SHORT, None
    if loop.stop_reason:
        status = HandsOnStatus.STOPPED
    elif len(resting) == needed:
        status, direction = HandsOnStatus.REGISTERED, np.random.default_rng(seed).standard_normal(3)
        error = settings.registration_error_m * direction / np.linalg.norm(direction)
        registered = read_only(np.mean(resting, axis=0) + error)
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    ended = f"stopped: {loop.stop_reason}" if loop.stop_reason else "completed"
    return HandsOn(status, goal, registered, np.array(law.seen.q), Trace(columns, {"ended": ended}))
