"""The numbers of the control law (`core/law.c`), computed from settings and an arm."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from moc_opt.control.settings import ControlSettings, per_joint
from moc_opt.errors import ControlError
from moc_opt.robots.model import RobotModel

# The next three are in the order of the core's enums.
PROJECTORS = ("dynamic", "static", "as_published")
FALLBACKS = ("damping", "hold", "least-violation")
LATE = ("hold", "zero", "iterate")
COURSE_K0_PER_S = 10.0  #: Lower bound on k0 along a course.
_CHECKS = ("check", "box_limit", "primal_limit", "relative_limit", "opposite_limit", "keep_off_limits", "hold_ticks")


def numbers_of(settings: ControlSettings, robot: RobotModel, period: float) -> dict[str, Any]:
    """Return the fields of the core's structs moc_law and moc_supervision, by name, for a control period [s]."""
    n, moc, follows, supervisor = robot.n, settings.law == "moc", settings.follows, settings.supervisor
    gains = settings.resolve_gains(robot.data.gains, n)
    gain, damping = gains.K_N2, gains.D_N2
    if follows:  # x is then the desired velocity, so D_N2 acts on x - v, as K_N2 does
        gain, damping = gain + damping, np.zeros(n)
    if not moc:
        damping = per_joint("[control] dcac_damping", settings.dcac_damping, n)
    observer = settings.observer_rate_per_s
    if observer and not observer * period < 1.0:
        name = "course_observer_gain_per_s" if follows else "observer_gain_per_s"
        raise ControlError(f"{name} = {observer} at a period of {period} s: give a gain below {1.0 / period:g}")
    turning = settings.course_margin_rad if follows else settings.limit_margin_rad
    margin = np.where(robot.chain.prismatic, settings.limit_margin_m, turning)
    half = 0.5 * (robot.q_max - robot.q_min)
    if not (half > margin).all():
        j = int(np.argmin(half - margin))
        kind = "limit_margin_m" if robot.chain.prismatic[j] else f"{'course' if follows else 'limit'}_margin_rad"
        raise ControlError(
            f"[control] {kind} = {margin[j]}: no room is left for joint {j + 1} between its limits; give less "
            f"than {half[j]:.3g}"
        )
    fraction = 1.0 if follows else settings.speed_fraction  # the planner limits the speed
    return {
        **{name: getattr(settings, name) for name in ("feedforward", "c0", "c1", "c2")},
        **{name: getattr(supervisor, name) for name in _CHECKS},
        "K_X": gains.K_X, "D_X": gains.D_X, "K_N": gains.K_N, "D_N": gains.D_N, "K_N2": gain, "D_N2": damping,
        "rcm_lambda": settings.rcm_lambda or 0.0, "projector": PROJECTORS.index(settings.projector),
        "tau_max": np.array(robot.tau_max) if settings.limit_torque else np.full(n, np.inf),
        "k0": max(settings.k0_per_s, COURSE_K0_PER_S) if follows else settings.k0_per_s,
        "rho": settings.regularization, "q_min": robot.q_min + margin, "q_max": robot.q_max - margin,
        "v_max": fraction * robot.v_max, "spare_speed": 1.0 / fraction - 1.0,
        "shaft_margin": float(settings.shaft_margin * robot.state(robot.data.q_home).tool_span ** 2),
        "observer_gain": observer, "period": period, "third_level": moc, "damped": not moc and bool(damping.any()),
        "fade": 1.0 if settings.ramp_s == 0.0 else min(1.0, period / settings.ramp_s),
        "climbs": moc and settings.climb == "scaled" and not follows,
        "fallback": FALLBACKS.index(settings.fallback), "late": LATE.index(supervisor.late),
        "budget_us": math.inf if supervisor.budget_us is None else supervisor.budget_us,
    }  # fmt: skip
