"""The C text around CasADi's generated functions: header, thin readable interface, self-test, Makefile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from moc_opt.embedded import templates
from moc_opt.embedded.layout import OBSERVED, Field
from moc_opt.embedded.symbolic import Tick
from moc_opt.inputs.names import in_comment

Array = NDArray[np.float64]

BAD_INPUT = 3
"""What moc_tick returns when an input is not finite; below it are the statuses of `solvers.exact`."""


class Recording(NamedTuple):
    """Consecutive ticks of a controller: what it saw, and the torque that it asked for."""

    q: Array
    """(k,n) [rad]"""
    v: Array
    """(k,n) [rad/s]"""
    tip_ref: Array
    """(k,3,3) rows X_d, dX_d, ddX_d"""
    trocar: Array
    """(k,2,3) rows P_t, dP_t"""
    tau: Array
    """(k,n) [Nm]"""


class SafeRecording(NamedTuple):
    """Consecutive ticks of a controller in its guard: what was measured, and the torque that was sent."""

    q: Array
    """(k,n) [rad]; may hold what is no number"""
    v: Array
    """(k,n) [rad/s]"""
    stamp: Array
    """(k,) numbers of the control periods in which that was measured"""
    tip_ref: Array
    """(k,3,3)"""
    trocar: Array
    """(k,2,3)"""
    wrench: Array
    """(k,6) force [N] and torque [Nm] of the tool on its mount, tool axes"""
    solve_us: Array
    """(k,) time of the solver [us]; zero where it was not asked"""
    tau: Array
    """(k,n) [Nm]"""
    sent: Array
    """(n,) torque before the first tick [Nm]"""
    stopped_at: int
    """the tick at which the guard stopped the arm; -1: it did not"""


def header(tick: Tick, title: str, constants: Mapping[str, Any]) -> str:
    """moc_tick.h. `title` and `constants` say in a comment what the numbers in the code came from.

    They may hold names from files and the text of any setting: nothing of it leaves the comment.
    """
    return templates.HEADER.substitute(
        n=tick.n,
        title=in_comment(title),
        constants="\n".join(f" *   {in_comment(f'{name} = {value}')}" for name, value in constants.items()),
        state=_members(tick.layout.state),
        report=_members(tick.layout.report),
        inputs="\n".join(f" *   {field.name}: {_meaning(field)}" for field in tick.layout.inputs),
        arguments=_arguments(tick.layout.inputs),
        start_arguments=_arguments(tick.layout.inputs[:2]),
        bad_input=BAD_INPUT,
    )


def implementation(tick: Tick) -> str:
    """moc_tick.c: CasADi's functions, kept static, and the interface around them."""
    names, state, report = tick.layout
    inputs = [field.name for field in names]
    follow = "solver" if any(field.name == "x" for field in report) else "damping" if tick.rows else "levels"
    return templates.IMPLEMENTATION.substitute(
        n=tick.n,
        **_generated(tick.start, tick.tick),
        arguments=_arguments(tick.layout.inputs),
        start_arguments=_arguments(tick.layout.inputs[:2]),
        start_given=", ".join(inputs[:2]),
        start_results=", ".join(_address("state->", field) for field in state),
        inputs=", ".join(inputs),
        given=", ".join([*inputs, *(_address("state->", field) for field in state[: OBSERVED + 1])]),
        results=", ".join(_address("next.", field) for field in state[:OBSERVED]),
        reported=",\n        ".join(_address("report->", field) for field in report),
        bad=" || ".join(f"!moc_all_finite({field.length}, {field.name})" for field in names),
        follow=templates.FOLLOW[follow],
    )


def arm(tick: Tick) -> str:
    """moc_arm.c: gravity torque and tool pose, for the guard."""
    return templates.ARM.substitute(_generated(tick.gravity, tick.tool_pose))


def _generated(*functions: Any) -> dict[str, str]:
    generator = ca.CodeGenerator("moc_casadi", {"with_mem": False})
    for function in functions:
        generator.add(function)
    return {
        "generated": generator.dump().strip(), "prologue": templates.PROLOGUE, "epilogue": templates.EPILOGUE,
    }  # fmt: skip


def self_test(tick: Tick) -> str:
    """main.c: compares with the recording and times itself."""
    return templates.MAIN.substitute(n=tick.n)


def recording(rows: Recording) -> str:
    """recording.h: the recorded ticks as one table."""
    table, lines = _table(rows)
    return templates.RECORDING.substitute(ticks=len(table), width=table.shape[1], rows=lines)


def safe_recording(rows: SafeRecording) -> str:
    """safe_recording.h: the same for the controller in its guard."""
    table, lines = _table(rows[:-2])
    return templates.SAFE_RECORDING.substitute(
        ticks=len(table), width=table.shape[1], rows=lines, stopped_at=rows.stopped_at, n=len(rows.sent),
        sent=", ".join(map(_number, rows.sent)),
    )  # fmt: skip


def _table(columns: tuple[Array, ...]) -> tuple[Array, str]:
    table = np.hstack([np.asarray(part).reshape(len(columns[0]), -1) for part in columns])
    return table, ",\n".join("    {" + ", ".join(map(_number, row)) + "}" for row in table)


def _number(value: float) -> str:
    if np.isnan(value):
        return "NAN"
    return repr(float(value)) if np.isfinite(value) else "HUGE_VAL" if value > 0.0 else "-HUGE_VAL"


def _meaning(field: Field) -> str:
    shape = f"{field.shape} ".replace(" ", "") + " " if field.shape else ""
    return shape + field.meaning


def _members(fields: tuple[Field, ...]) -> str:
    return "\n".join(
        f"    double {field.name}{f'[{field.length}]' if field.shape else ''}; /* {_meaning(field)} */"
        for field in fields
    )


def _address(owner: str, field: Field) -> str:
    return f"{'' if field.shape else '&'}{owner}{field.name}"


def _arguments(fields: tuple[Field, ...]) -> str:
    return ", ".join(f"const double {field.name}[{field.length}]" for field in fields)
