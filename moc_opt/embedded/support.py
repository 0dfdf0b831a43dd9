"""The settings that the C code supports; all others are refused, never ignored."""

from __future__ import annotations

from typing import NamedTuple

from moc_opt.control import ControlSettings
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import ControlError
from moc_opt.inputs.settings import Settings
from moc_opt.model.robot_model import RobotModel
from moc_opt.solvers.base import Solver
from moc_opt.solvers.exact.solver import Exact


class TickSpec(NamedTuple):
    """The source of a compiled tick, the arguments of `Controller`; C contains the solver ``exact`` only."""

    robot: RobotModel
    settings: ControlSettings
    solver: Solver | None
    period: float


# Every field of ControlSettings that the generated tick follows, `backend` being the choice of C itself; the fields of
# `supervisor` are below.
OBEYED = frozenset((
    "law", "gains", "K_X", "D_X", "K_N", "D_N", "K_N2", "D_N2", "dcac_damping", "rcm_lambda", "projector",
    "feedforward", "observer_gain_per_s", "limit_torque", "k0_per_s", "c0", "c1", "c2", "regularization", "fallback",
    "speed_fraction", "limit_margin_rad", "limit_margin_m", "shaft_margin", "ramp_s", "backend", "supervisor",
))  # fmt: skip

# What is read where a course is followed alone.
OF_A_COURSE = frozenset((
    "course", "horizon_s", "replan_per_s", "course_speed_fraction", "course_margin_rad", "course_observer_gain_per_s",
))  # fmt: skip


# Every field of SafetyFilterSettings and SupervisorSettings that the C code follows.
GUARDED = frozenset((
    "torque_rate_Nm_per_s", "position_margin_rad", "position_margin_m", "wall_stiffness_Nm_per_rad",
    "wall_damping_Nm_s_per_rad", "wall_brake_rad_per_s2",
    "jump_rad", "speed_factor", "patience_ticks", "tip_error_m", "tip_error_s",
    "rcm_error_m", "rcm_warning_m", "trocar_force_N", "trocar_force_warning_N", "tip_force_N", "incision_s",
    "stop_damping_Nm_s_per_rad", "stop_s", "stop_holding", "stop_yield_N", "stop_yield_s",
    "motion", "motion_s", "motion_rad", "motion_lag_s",
    "repeat_m", "repeat_torque", "repeat_whole_torque", "repeat_whole_m", "repeat_whole_ticks",
    "stuck_torque", "stuck_friction", "stuck_rad_per_s", "repeat_joint_ticks", "repeat_reading_ticks",
    "residual_torque", "residual_whole_torque", "residual_rate_per_s", "residual_s",
))  # fmt: skip
SUPERVISED = frozenset((
    "check", "primal_limit", "box_limit", "relative_limit", "opposite_limit", "hold_ticks", "keep_off_limits",
    "budget_us", "late",
))  # fmt: skip


def check_safety_filter(guard: SafetyFilterSettings) -> None:
    """Refuse limits that the C code does not hold.

    Raises:
        ControlError: naming the setting, its value and the cure.
    """
    _refuse_unknown(guard, GUARDED)


def _refuse_unknown(settings: Settings, known: frozenset[str]) -> None:
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if name not in known and value != field.get_default(call_default_factory=True):
            raise ControlError(f"{settings.KIND} {name} = {value!r} is not known to generated C: leave it out")


def check_supported(spec: TickSpec) -> None:
    """Refuse what cannot be generated.

    Raises:
        ControlError: the generated code cannot do what a setting asks for; the message names field and cure.
    """
    robot, settings, solver, period = spec
    moc = settings.law == "moc"
    if moc and not isinstance(solver, Exact):
        name = getattr(solver, "name", None)
        raise ControlError(f"[solver] name = {name!r}: generated C contains 'exact' only; take that one")
    if not moc and solver is not None:
        raise ControlError(f"law: 'dcac' takes no solver, given {solver.name!r}; leave it out")
    # What a law never reads cannot be left out of its C.
    unread = frozenset[str]() if settings.follows else OF_A_COURSE
    _refuse_unknown(settings, OBEYED | unread | (set() if moc else {"climb"}))
    _refuse_unknown(settings.supervisor, SUPERVISED)
    if not 0.0 <= settings.observer_gain_per_s * period < 1.0:
        raise ControlError(
            f"[control] observer_gain_per_s = {settings.observer_gain_per_s} at a period of {period} s: "
            f"keep it below {1.0 / period:g}"
        )
    if moc or settings.damps_dcac:
        moving = int(robot.moves.any(axis=0).sum())
        if moving != 6:
            raise ControlError(
                f"[robot] name = {robot.data.name!r}: {moving} joints move tip or wrist, and generated C needs "
                "six (one swivel; the others idle): put the tool on the last joint's axis, or compute in Python"
            )
