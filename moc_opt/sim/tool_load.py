"""The tool's own part of the mount sensor's reading, and the external wrench that is left without it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array, read_only
from moc_opt.sim.settings import GRAVITY

_GRAVITY = np.array(GRAVITY)


@dataclass(frozen=True, eq=False)
class ToolLoad:
    """The mount sensor's reading when nothing touches the tool: its weight, its inertia force, and a bias.

    The sensor shows the wrench of the tool on the mount, in sensor axes R (world from sensor), about itself:
        force  = R^T (F + m (g - a)) + bias,   torque = R^T T + com x R^T m (g - a) + bias
    with F, T the external force and torque about the sensor, and a the acceleration of the tool's centre of
    mass. The torque about the centre of mass that angular acceleration needs is left out: m length^2 / 12, or
    0.002 Nm for each rad/s^2 of the default tool.
    """

    mass: float
    """[kg]"""
    com: Array
    """(3,) centre of mass in sensor axes [m]."""
    bias: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) reading without any load [N, Nm]."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mass) and self.mass >= 0.0):
            raise PlantError(f"tool load mass = {self.mass!r}: give a mass in kg, 0 or more")
        object.__setattr__(self, "com", _vector("tool load com", self.com, (3,)))
        object.__setattr__(self, "bias", _vector("tool load bias", self.bias, (6,)))

    @classmethod
    def identify(cls, readings: ArrayLike, rotations: ArrayLike) -> ToolLoad:
        """Find mass, centre of mass and bias from readings at rest, free of contact, by linear least squares.

        Args:
            readings: (k, 6) sensor readings [N, Nm].
            rotations: (k, 3, 3) sensor orientations, world from sensor.

        Raises:
            PlantError: shapes differ, or the poses are too alike to tell weight from bias (three, tens
                of degrees apart, are enough).
        """
        wrenches = np.asarray(readings, dtype=np.float64)
        turns = np.asarray(rotations, dtype=np.float64)
        k = len(wrenches)
        wrenches = _vector("readings", wrenches, (k, 6))
        down = _vector("rotations", turns, (k, 3, 3)).transpose(0, 2, 1) @ _GRAVITY
        if k < 3 or np.linalg.svd(down - down.mean(axis=0), compute_uv=False)[1] < 1.0:
            raise PlantError(
                f"{k} poses turn the tool too little to tell its weight from the sensor's bias: "
                "take three or more, tens of degrees apart about different axes"
            )
        columns = np.concatenate([down.reshape(-1, 1), np.tile(np.eye(3), (k, 1))], axis=1)
        mass, *force_bias = np.linalg.lstsq(columns, wrenches[:, :3].reshape(-1), rcond=None)[0]
        if not mass > 0.0:
            raise PlantError(f"the readings make a tool of {mass:.3g} kg: give what the tool exerts on the mount, in N")
        # Linear in m com: column j of (m com) x g is e_j x g.
        lever = np.cross(np.eye(3), down[:, None, :]).transpose(0, 2, 1).reshape(-1, 3)
        columns = np.concatenate([lever, np.tile(np.eye(3), (k, 1))], axis=1)
        moment = np.linalg.lstsq(columns, wrenches[:, 3:].reshape(-1), rcond=None)[0]
        return cls(float(mass), moment[:3] / mass, np.concatenate([force_bias, moment[3:]]))

    def tared(self, reading: ArrayLike, rotation: ArrayLike) -> ToolLoad:
        """Return the same load, its bias such that this reading (6,), at rest and free of contact, means zero."""
        wrench = _vector("reading", reading, (6,))
        return replace(self, bias=wrench - replace(self, bias=np.zeros(6)).expected(rotation))

    def expected(self, rotation: ArrayLike, acceleration: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """Compute the reading (6,) without contact for an orientation (3, 3) and an acceleration of its com [m/s^2]."""
        turn = _vector("rotation", rotation, (3, 3))
        weight = self.mass * (turn.T @ (_GRAVITY - _vector("acceleration", acceleration, (3,))))
        return np.concatenate([weight, np.cross(self.com, weight)]) + self.bias

    def external(self, reading: ArrayLike, rotation: ArrayLike, acceleration: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """Estimate the external wrench (6,) on the tool: force [N], torque about the sensor [Nm], world axes.

        Args:
            reading: (6,) sensor reading.
            rotation: (3, 3) sensor orientation, world from sensor.
            acceleration: (3,) of the tool's centre of mass, world axes [m/s^2].

        Raises:
            PlantError: a shape is wrong or a value is not finite.
        """
        rest = _vector("reading", reading, (6,)) - self.expected(rotation, acceleration)
        return np.concatenate([np.asarray(rotation) @ rest[:3], np.asarray(rotation) @ rest[3:]])


def _vector(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise PlantError(f"{name} must be finite and of shape {shape}: it is {array.tolist()!r:.100}")
    return read_only(array)
