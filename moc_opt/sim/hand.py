"""A simulated hand that pulls a point of the tool to a goal, with a person's force."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Settings
from moc_opt.numerics.arrays import Array


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
    """Return the vector itself, or shortened to `most` where it is longer."""
    length = math.sqrt(float(vector @ vector))
    return vector if length <= most else vector * (most / length)
