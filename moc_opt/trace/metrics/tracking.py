"""Errors of tip and remote centre of motion (RCM), and the trocar's force."""

from __future__ import annotations

from moc_opt.trace.metrics.registry import floats, metric
from moc_opt.trace.trace import Trace


@metric("mm")
def tip_error_mean_mm(trace: Trace) -> float:
    """Mean distance of the tip from its reference in the base frame: absolute accuracy [mm]."""
    return 1e3 * floats(trace, "tip_error_m").mean()


@metric("mm")
def tip_error_max_mm(trace: Trace) -> float:
    """Largest distance of the tip from its reference in the base frame: absolute accuracy [mm]."""
    return 1e3 * floats(trace, "tip_error_m").max()


@metric("mm")
def tip_error_registered_mean_mm(trace: Trace) -> float:
    """Mean distance of the tip from its reference, both in the frame registered at the start [mm]."""
    return 1e3 * floats(trace, "tip_error_registered_m").mean()


@metric("mm")
def tip_error_registered_max_mm(trace: Trace) -> float:
    """Largest distance of the tip from its reference, both in the frame registered at the start [mm]."""
    return 1e3 * floats(trace, "tip_error_registered_m").max()


@metric("mm")
def tip_error_model_mean_mm(trace: Trace) -> float:
    """Mean distance of the tip from its reference by the robot's own kinematics, which its controller sees [mm]."""
    return 1e3 * floats(trace, "tip_error_model_m").mean()


@metric("mm")
def tip_error_model_max_mm(trace: Trace) -> float:
    """Largest distance of the tip from its reference by the robot's own kinematics [mm]."""
    return 1e3 * floats(trace, "tip_error_model_m").max()


@metric("mm")
def rcm_error_mean_mm(trace: Trace) -> float:
    """Mean distance of the shaft's line from the true trocar [mm]; the registration's error is part of it."""
    return 1e3 * floats(trace, "rcm_error_m").mean()


@metric("mm")
def rcm_error_max_mm(trace: Trace) -> float:
    """Largest distance of the shaft's line from the trocar [mm]."""
    return 1e3 * floats(trace, "rcm_error_m").max()


@metric("mm")
def rcm_error_registered_mean_mm(trace: Trace) -> float:
    """Mean distance of the true shaft's line from the trocar as registered by touch [mm]."""
    return 1e3 * floats(trace, "rcm_error_registered_m").mean()


@metric("mm")
def rcm_error_registered_max_mm(trace: Trace) -> float:
    """Largest distance of the true shaft's line from the trocar as registered by touch [mm]."""
    return 1e3 * floats(trace, "rcm_error_registered_m").max()


@metric("mm")
def rcm_error_model_mean_mm(trace: Trace) -> float:
    """Mean distance of the shaft from the registered trocar by the robot's own kinematics [mm]."""
    return 1e3 * floats(trace, "rcm_error_model_m").mean()


@metric("mm")
def rcm_error_model_max_mm(trace: Trace) -> float:
    """Largest distance of the shaft from the registered trocar by the robot's own kinematics [mm]."""
    return 1e3 * floats(trace, "rcm_error_model_m").max()


@metric("N")
def trocar_force_mean_N(trace: Trace) -> float:
    """Mean magnitude of the trocar's force on the shaft [N]."""
    return floats(trace, "trocar_force_N").mean()


@metric("N")
def trocar_force_max_N(trace: Trace) -> float:
    """Largest magnitude of the trocar's force on the shaft [N]."""
    return floats(trace, "trocar_force_N").max()
