"""From settings and an arm to the core's law, whose equations stand in docs/method.md and `moc_opt/core/levels.c`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.control.gains import per_joint
from moc_opt.control.settings import PROJECTORS, ControlSettings
from moc_opt.errors import ControlError
from moc_opt.robots.model import RobotModel

FALLBACKS = ("damping", "hold", "least-violation")
LATE = ("hold", "zero", "iterate")  #: In the order of the core's enums.


def shaft_margin_m2(settings: ControlSettings, robot: RobotModel) -> float:
    """Return the margin of mu_shaft [m^2], proportional to the squared distance of wrist point and tip."""
    return float(settings.shaft_margin * robot.state(robot.data.q_home).tool_span ** 2)


def box_limits(
    q_min: Array, q_max: Array, v_max: Array, *, margin: float | Array = 0.0, speed_fraction: float = 1.0
) -> Array:
    """Return the limits of the box on x: (3, n) rows q_min + margin, q_max - margin, speed_fraction v_max.

    The box has to close before the wall of the safety filter acts on the joint.

    Args:
        q_min, q_max: (n,) joint limits [rad].
        v_max: (n,) [rad/s].
        margin: distance kept from either joint limit, one number or (n,) [rad, m].
        speed_fraction: of v_max.

    Raises:
        ControlError: the margins of a joint meet.
    """
    left = 0.5 * (q_max - q_min) - margin
    j = int(np.argmin(left))
    if not left[j] > 0.0:
        raise ControlError(
            f"[control] limit_margin_rad = {float(np.broadcast_to(margin, left.shape)[j])}: nothing is left of joint "
            f"{j + 1} between its limits; give less than {0.5 * (q_max - q_min)[j]:.3g} (limit_margin_m, if it slides)"
        )
    return np.ascontiguousarray([q_min + margin, q_max - margin, speed_fraction * v_max])


def law_of(settings: ControlSettings, robot: RobotModel, period: float) -> core.Law:
    """Make the law that the settings ask for on this arm; arguments and errors of `numbers_of`."""
    return core.Law(robot.arm, **numbers_of(settings, robot, period))


def numbers_of(settings: ControlSettings, robot: RobotModel, period: float) -> dict[str, Any]:
    """Return the law's numbers by the names of the core's moc_law and moc_supervision.

    Args:
        period: of control [s].

    Raises:
        ControlError, UnknownNameError: a gain is missing, the box leaves a joint no room, or the observer's gain is
            too large for the period.
    """
    n, moc, supervisor = robot.n, settings.law == "moc", settings.supervisor
    gains = settings.resolve_gains(robot.data.gains, n)
    gain, damping = gains.K_N2, gains.D_N2
    if settings.follows:  # x is the desired speed: its error is damped, not the speed itself
        gain, damping = gain + damping, np.zeros(n)
    if not moc:
        damping = per_joint("[control] dcac_damping", settings.dcac_damping, n)
    observer = settings.observer_rate_per_s
    if observer and not observer * period < 1.0:
        name = "course_observer_gain_per_s" if settings.follows else "observer_gain_per_s"
        raise ControlError(f"{name} = {observer} at a period of {period} s: keep it below {1.0 / period:g}")
    q_min, q_max, v_max = box_limits(
        robot.q_min, robot.q_max, robot.v_max,
        margin=settings.limit_margins(robot.chain.prismatic), speed_fraction=settings.box_speed_fraction,
    )  # fmt: skip
    return {
        "K_X": gains.K_X, "D_X": gains.D_X, "K_N": gains.K_N, "D_N": gains.D_N,
        "rcm_lambda": settings.rcm_lambda or 0.0, "projector": PROJECTORS.index(settings.projector),
        "feedforward": settings.feedforward,
        "K_N2": np.array(gain, dtype=np.float64), "D_N2": np.array(damping, dtype=np.float64),
        "tau_max": np.array(robot.tau_max) if settings.limit_torque else np.full(n, np.inf),
        "k0": settings.box_k0_per_s, "c0": settings.c0, "c1": settings.c1, "c2": settings.c2,
        "rho": settings.regularization, "q_min": q_min, "q_max": q_max, "v_max": v_max,
        "shaft_margin": shaft_margin_m2(settings, robot),
        "spare_speed": 1.0 / settings.box_speed_fraction - 1.0, "observer_gain": observer, "period": period,
        "fade": 1.0 if settings.ramp_s == 0.0 else min(1.0, period / settings.ramp_s), "third_level": moc,
        "damped": not moc and settings.damps_dcac,
        "climbs": moc and settings.climb == "scaled" and not settings.follows,
        "check": supervisor.check, "box_limit": supervisor.box_limit, "primal_limit": supervisor.primal_limit,
        "relative_limit": supervisor.relative_limit, "opposite_limit": supervisor.opposite_limit,
        "hold_ticks": min(supervisor.hold_ticks, 2**31 - 1), "keep_off_limits": supervisor.keep_off_limits,
        "fallback": FALLBACKS.index(settings.fallback), "late": LATE.index(supervisor.late),
        "budget_us": math.inf if supervisor.budget_us is None else supervisor.budget_us,
    }  # fmt: skip
