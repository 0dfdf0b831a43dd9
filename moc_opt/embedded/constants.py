"""moc_constants.h and moc_constants.c: the numbers that the hand-written C files are filled with."""

from __future__ import annotations

from moc_opt.control import ControlSettings
from moc_opt.control.gains import per_joint
from moc_opt.control.safety_filter import PRESS_PER_S
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.embedded.operations import worst_path
from moc_opt.embedded.source import number, render
from moc_opt.embedded.support import TickSpec
from moc_opt.embedded.symbolic import Tick
from moc_opt.model.robot_model import RobotModel
from moc_opt.solvers.base import Solver
from moc_opt.solvers.exact.solver import Exact

LATE = ("hold", "zero", "iterate")
FALLBACKS = ("damping", "hold", "least-violation")
DEFAULT_SAFETY_FILTER = SafetyFilterSettings()


def constants(tick: Tick, spec: TickSpec, guard: SafetyFilterSettings) -> dict[str, str]:
    """Write both files, text by name."""
    robot, control, solver, period = spec
    macros = _law(tick, control, solver, period) | _supervisor(control) | _guard(robot, guard, period)
    macros["MOC_OPERATIONS"] = f"{worst_path(tick)['in all']} /* floating-point operations of the longest step */"
    gains, moc = control.resolve_gains(robot.data.gains, robot.n), control.law == "moc"
    arrays = {
        "moc_q_min": robot.q_min, "moc_q_max": robot.q_max, "moc_v_max": robot.v_max, "moc_tau_max": robot.tau_max,
        "moc_wall_margin": guard.position_margins(robot.chain.prismatic),
        "moc_held": guard.held(robot.tau_max, robot.data.coulomb_friction),
        "moc_pull": gains.K_N2,
        "moc_damping": gains.D_N2 if moc else per_joint("[control] dcac_damping", control.dcac_damping, robot.n),
    }  # fmt: skip
    levels = {
        "moc_warning": (guard.rcm_warning_m, guard.trocar_force_warning_N),
        "moc_limit": (guard.rcm_error_m, guard.trocar_force_N),
    }
    defined = arrays | levels
    return {
        "moc_constants.h": render(
            "moc_constants.h", macros=macros, width=max(map(len, macros)), arrays=arrays, levels=levels
        ),
        "moc_constants.c": render("moc_constants.c", defined=defined),
    }


def _law(tick: Tick, control: ControlSettings, solver: Solver | None, period: float) -> dict[str, str]:
    moc = control.law == "moc"
    fade = min(1.0, period / control.ramp_s) if moc and control.ramp_s > 0.0 else 1.0
    return {
        "MOC_N": str(tick.n),
        "MOC_ROWS": str(tick.rows),
        "MOC_SOLVES": str(int(moc)),
        "MOC_A_OF(report)": "((report)->subproblem)" if moc else "((report)->A)",
        "MOC_B_OF(report)": f"((report)->subproblem + {6 * tick.n})" if moc else "NULL",
        "MOC_PERIOD": number(period),
        "MOC_FADE": number(fade),
        "MOC_LIMITS_TORQUE": str(int(control.limit_torque)),
        "MOC_TOLERANCE": number(solver.tolerance if isinstance(solver, Exact) else 0.0),
    }


def _macro(name: str) -> str:
    return name.upper().replace("-", "_")


def _supervisor(control: ControlSettings) -> dict[str, str]:
    watch = control.supervisor
    return {
        **{f"MOC_FALLBACK_{_macro(name)}": str(code) for code, name in enumerate(FALLBACKS)},
        "MOC_FALLBACK": f"MOC_FALLBACK_{_macro(control.fallback)}",
        "MOC_CHECK": str(int(watch.check)),
        "MOC_PRIMAL_LIMIT": number(watch.primal_limit),
        "MOC_RELATIVE_LIMIT": number(watch.relative_limit),
        "MOC_OPPOSITE_LIMIT": number(watch.opposite_limit),
        "MOC_HOLD_TICKS": str(watch.hold_ticks),
        "MOC_KEEP_OFF_LIMITS": str(int(watch.keep_off_limits)),
        "MOC_HAS_BUDGET": str(int(watch.budget_us is not None)),
        "MOC_BUDGET_US": number(watch.budget_us),
        **{f"MOC_LATE_{name.upper()}": str(code) for code, name in enumerate(LATE)},
        "MOC_LATE": f"MOC_LATE_{watch.late.upper()}",
    }


def _guard(robot: RobotModel, guard: SafetyFilterSettings, period: float) -> dict[str, str]:
    return {
        "MOC_TORQUE_STEP": number(guard.torque_rate_Nm_per_s * period),
        "MOC_WALL_STIFFNESS": number(guard.wall_stiffness_Nm_per_rad),
        "MOC_WALL_DAMPING": number(guard.wall_damping_Nm_s_per_rad),
        "MOC_WALL_BRAKE": number(guard.wall_brake_rad_per_s2), "MOC_JUMP": number(guard.jump_rad),
        "MOC_SPEED_FACTOR": number(guard.speed_factor), "MOC_PATIENCE_TICKS": str(guard.patience_ticks),
        "MOC_TIP_ERROR": number(guard.tip_error_m), "MOC_TIP_SHARE": number(min(1.0, period / guard.tip_error_s)),
        "MOC_INCISION_SHARE": number(min(1.0, period / guard.incision_s)), "MOC_TIP_FORCE": number(guard.tip_force_N),
        "MOC_TOOL_MASS": number(robot.data.tool_mass), "MOC_TOOL_LENGTH": number(robot.data.tool_length),
        **_motion(guard, robot.n, period), "MOC_STOP_HOLDING": number(guard.stop_holding),
        "MOC_STOP_YIELD": number(guard.stop_yield_N), "MOC_STOP_YIELD_TICKS": str(round(guard.stop_yield_s / period)),
        "MOC_PRESS_SHARE": number(min(1.0, PRESS_PER_S * period)),
        "MOC_STOP_DAMPING": number(guard.stop_damping_Nm_s_per_rad), "MOC_STOP_SECONDS": number(guard.stop_s),
    }  # fmt: skip


def _motion(guard: SafetyFilterSettings, n: int, period: float) -> dict[str, str]:
    return {
        "MOC_MOTION": str(int(guard.motion)),
        "MOC_MOTION_S": number(guard.motion_s),
        "MOC_MOTION_RAD": number(guard.motion_rad),
        "MOC_MOTION_LAG_S": number(guard.motion_lag_s),
        "MOC_REPEAT_M": number(guard.repeat_m),
        "MOC_REPEAT_TORQUE": number(guard.repeat_torque),
        "MOC_REPEAT_WHOLE_TORQUE": number(guard.repeat_whole_torque),
        "MOC_REPEAT_WHOLE_M": number(guard.repeat_whole_m),
        "MOC_REPEAT_WHOLE_TICKS": str(guard.repeat_whole_ticks),
        "MOC_REPLAYED_TICKS": number(guard.replayed_ticks(n)),
        "MOC_REPEAT_JOINT_TICKS": number(guard.repeat_joint_ticks),
        "MOC_REPEAT_READING_TICKS": number(guard.repeat_reading_ticks),
        "MOC_STUCK_SPEED": number(guard.stuck_rad_per_s),
        "MOC_RESIDUAL_TORQUE": number(guard.residual_torque),
        "MOC_RESIDUAL_WHOLE": number(guard.residual_whole_torque),
        "MOC_RESIDUAL_RATE": number(guard.residual_rate_per_s),
        "MOC_RESIDUAL_SHARE": number(min(1.0, period / guard.residual_s)),
        "MOC_SETTLING_TICKS": str(guard.settling_ticks(period)),
    }
