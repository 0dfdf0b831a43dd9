"""The controller's model and the plant's are two engines reading one URDF: whether they read the same arm."""

from __future__ import annotations

import numpy as np

from moc_opt.errors import RobotError
from moc_opt.robots.model import RobotModel
from moc_opt.sim.reference import reference_terms

TOLERANCE = 1e-6
"""Of the largest entry of M (without rotors) and of h, and of the tip's distance; rounding makes about 1e-14."""
POSES = 3
GRAVITY = 9.81
UNITS = {"M": "kg m^2", "h": "Nm", "tip": "m", "wrist": "m"}


def check_engines(robot: RobotModel) -> None:
    """Compare inertia M, bias h, tip and wrist of pinocchio and MuJoCo, at home and at seeded poses in motion.

    Both have the robot's data alone: the plant's defects (masses, calibration, friction, elasticity) are drawn later.
    It takes about 2 ms.

    Raises:
        RobotError: they differ by more than `TOLERANCE`; the message names the quantity and the difference.
        PlantError: MuJoCo cannot take the robot.
    """
    data, rng = robot.data, np.random.default_rng(0)
    q = np.vstack([data.q_home, rng.uniform(data.q_min, data.q_max, (POSES - 1, data.n))])
    v = rng.uniform(-1.0, 1.0, q.shape) * np.minimum(data.v_max, 1.0)
    for position, speed, theirs in zip(q, v, reference_terms(data, q, v), strict=True):
        ours = robot.state(position, speed)
        # Rotor inertia is added to both and hides what small links differ in; only its rounding is left in the scale.
        rotor = np.diag(data.rotor_inertia)
        heavy = max(np.abs(theirs.M - rotor).max(), 1e-8 * rotor.max())
        reach = max(1e-3, float(np.linalg.norm(theirs.tip)))
        sizes = {"M": heavy, "h": np.abs(theirs.h).max() + GRAVITY * heavy, "tip": reach, "wrist": reach}
        for name, size in sizes.items():
            off = float(np.abs(getattr(ours, name) - getattr(theirs, name)).max())
            if not off <= TOLERANCE * size:
                raise RobotError(
                    f"robot {data.name!r}: pinocchio and MuJoCo differ in {name} by {off:.3g} {UNITS[name]}, "
                    f"{off / size:.2g} of its size ({TOLERANCE:g} is allowed), at q = {np.round(position, 3)}: "
                    "they read its URDF differently; load it with moc_opt.load_robot, which writes it anew, and if it "
                    "was, report the file"
                )
