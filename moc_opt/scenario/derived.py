"""Columns that follow from the recorded ones: the robot's own errors, residuals of the answers, the largest mu."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.planning import pose_map
from moc_opt.qp.problem import compute_residuals
from moc_opt.qp.residuals import Residuals
from moc_opt.robots.model import RobotModel
from moc_opt.sim.plant import Plant
from moc_opt.sim.record import TaskOffset
from moc_opt.solvers.base import Status
from moc_opt.tasks.trocar import shaft_distance

Columns = Mapping[str, NDArray[Any]]

AT_ONCE = 5000
"""Answers whose residuals are computed together."""


def model_errors(columns: Columns, robot: RobotModel, plant: Plant, offset: TaskOffset) -> dict[str, NDArray[Any]]:
    """Compute tip and RCM error by the robot's own kinematics; none if the encoders are not on the links."""
    settings, mismatch = plant.settings, plant.mismatch
    if settings.elastic and settings.encoder_side == "motor":
        return {}
    if not mismatch.displaces:
        return {
            "tip_error_model_m": columns["tip_error_m"],
            "rcm_error_model_m": columns["rcm_error_registered_m"],
        }
    tips, wrists = robot.tool_along(columns["q_rad"] + mismatch.encoder_bias)
    told = columns["trocar_registered_m"] - offset.trocar
    return {
        "tip_error_model_m": np.linalg.norm(columns["tip_ref_m"] - tips, axis=1),
        "rcm_error_model_m": shaft_distance(tips, wrists, told),
    }


def residual_columns(columns: Columns) -> dict[str, NDArray[Any]]:
    """Compute every answer's residuals, and whether they verify it; none where no subproblem was solved."""
    if "subproblem" not in columns:
        return {}
    x = columns["x_rad_per_s"]
    parts = [slice(first, first + AT_ONCE) for first in range(0, len(x), AT_ONCE)]
    each = [compute_residuals(columns["subproblem"][part], x[part], columns["dual"][part]) for part in parts]
    found = Residuals(*map(np.concatenate, zip(*each, strict=True)))
    silent = ~np.isfinite(x).all(axis=1) & (columns["status"] != Status.SOLVED.label)
    figures = {name: np.where(silent, np.nan, figure) for name, figure in found._asdict().items()}
    return {"verified": found.verified(), **figures}


def largest_mu(poses: Array, robot: RobotModel, samples: int) -> tuple[Array, dict[str, str]]:
    """Compute the largest mu at evenly spaced ticks over every feasible pose with the same tip and wrist.

    Args:
        poses: (N, n) [rad].
        samples: ticks at which it is computed.

    Returns:
        (N,) the largest mu, NaN between those ticks and where the pose is no number; and the entry of a trace's meta
        that says how it was found (`moc_opt.planning.pose_map`), none where nothing was.
    """
    bound = np.full(len(poses), np.nan)
    ticks = np.linspace(0, len(poses) - 1, min(samples, len(poses))).astype(int)
    ticks = ticks[np.isfinite(poses[ticks]).all(axis=1)]
    if not len(ticks):
        return bound, {}
    found = pose_map.largest_mu(robot, np.asarray(poses[ticks], dtype=np.float64))
    bound[ticks] = found.mu
    return bound, {"mu_bound_method": found.method}
