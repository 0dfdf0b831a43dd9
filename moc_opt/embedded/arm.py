"""A serial arm as plain numbers, the constants of the symbolic equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array

_DUST = 1e-14  # cos(pi/2) of a URDF angle is 6e-17: such numbers are meant to be zero or one


@dataclass(frozen=True, eq=False)
class Arm:
    """The numbers of a serial arm: chain, bodies about their joint's frame, rotors, gravity."""

    n: int
    rotations: Array
    """(n,3,3) placement of joint j in the frame of joint j - 1"""
    origins: Array
    """(n,3) [m]"""
    axes: Array
    """(n,3) unit vectors in the joint's own frame"""
    prismatic: NDArray[np.bool_]
    """(n,)"""
    offsets: Array
    """(2,3) tip and wrist in the last joint's frame [m]"""
    mass: Array
    """(n,) [kg]"""
    first_moment: Array
    """(n,3) mass times centre of mass [kg m]"""
    inertia: Array
    """(n,3,3) about the joint frame's origin [kg m^2]"""
    rotor_inertia: Array
    """(n,) [kg m^2]"""
    gravity: Array
    """(3,) [m/s^2], world axes"""
    moves: NDArray[np.bool_]
    """(2,n) whether a joint moves the tip, the wrist"""

    @classmethod
    def of(cls, robot: RobotModel) -> Arm:
        """Read the numbers off the robot's chain and off pinocchio's reading of its URDF."""
        model, chain = pin.buildModelFromXML(robot.data.urdf), robot.chain
        bodies = [model.inertias[j + 1] for j in range(robot.n)]
        crosses = [pin.skew(body.lever) for body in bodies]
        return cls(
            n=robot.n,
            rotations=without_dust(chain.rotations),
            origins=without_dust(chain.origins),
            axes=without_dust(chain.axes),
            prismatic=chain.prismatic,
            offsets=without_dust(chain.offsets),
            mass=np.array([body.mass for body in bodies]),
            first_moment=without_dust(np.array([body.mass * body.lever for body in bodies])),
            inertia=without_dust(np.array([b.inertia - b.mass * c @ c for b, c in zip(bodies, crosses, strict=True)])),
            rotor_inertia=robot.data.rotor_inertia,
            gravity=np.array(model.gravity.linear),
            moves=robot.moves,
        )


def without_dust(values: Array) -> Array:
    """Return the values, with numbers that are whole but for rounding made whole."""
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < _DUST, nearest + 0.0, values)
