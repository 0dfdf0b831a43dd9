"""Errors of tip and remote centre of motion (RCM), and the trocar's force: mean and largest of a column each."""

from __future__ import annotations

import numpy as np

from moc_opt.trace.metrics.registry import Metric, figure


def _mean_and_max(column: str, unit: str, about: str, of_mean: str = "") -> tuple[Metric, Metric]:
    """Register NAME_mean_UNIT and NAME_max_UNIT of the column NAME_m or NAME_N; ``of_mean`` is of the mean alone."""
    stem = column.rpartition("_")[0]
    return (
        figure(f"{stem}_mean_{unit}", column, unit, f"Mean {about} [{unit}]{of_mean}.", np.mean),
        figure(f"{stem}_max_{unit}", column, unit, f"Largest {about} [{unit}].", np.max),
    )


tip_error_mean_mm, tip_error_max_mm = _mean_and_max(
    "tip_error_m", "mm", "distance of the tip from its reference in the base frame: absolute accuracy"
)
tip_error_registered_mean_mm, tip_error_registered_max_mm = _mean_and_max(
    "tip_error_registered_m", "mm", "distance of the tip from its reference, both in the frame registered at the start"
)
tip_error_model_mean_mm, tip_error_model_max_mm = _mean_and_max(
    "tip_error_model_m", "mm", "distance of the tip from its reference by the robot's own kinematics",
    ", which its controller sees",
)  # fmt: skip
rcm_error_mean_mm, rcm_error_max_mm = _mean_and_max(
    "rcm_error_m", "mm", "distance of the shaft's line from the true trocar", "; the registration's error is part of it"
)
rcm_error_registered_mean_mm, rcm_error_registered_max_mm = _mean_and_max(
    "rcm_error_registered_m", "mm", "distance of the true shaft's line from the trocar as registered by touch"
)
rcm_error_model_mean_mm, rcm_error_model_max_mm = _mean_and_max(
    "rcm_error_model_m", "mm", "distance of the shaft from the registered trocar by the robot's own kinematics"
)
trocar_force_mean_N, trocar_force_max_N = _mean_and_max(
    "trocar_force_N", "N", "magnitude of the trocar's force on the shaft"
)
