"""Fill the templates of the C files in ``c/``: header, interface around CasADi's functions, recordings, Makefile."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from moc_opt.control.called_tick import BAD_INPUT
from moc_opt.embedded.layout import OBSERVED
from moc_opt.embedded.symbolic import Tick
from moc_opt.inputs.names import in_comment
from moc_opt.numerics.arrays import Array


class Recording(NamedTuple):
    """Consecutive ticks of a controller: its inputs and its torque."""

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
    """Consecutive ticks of a controller behind its safety filter: measurements, and torques that were applied."""

    q: Array
    """(k,n) [rad]; may be NaN"""
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
    applied: Array
    """(n,) torque before the first tick [Nm]"""
    stopped_at: int
    """the tick at which the safety filter stopped the arm; -1: it did not"""


def header(tick: Tick, title: str, constants: Mapping[str, Any]) -> str:
    """Write moc_tick.h. `title` and `constants` say in a comment what the numbers in the code came from.

    They may hold names from files and the text of any setting: nothing of it leaves the comment.
    """
    lines = [in_comment(f"{name} = {value}") for name, value in constants.items()]
    return render("moc_tick.h", **_interface(tick), title=in_comment(title), constants=lines, bad_input=BAD_INPUT)


def implementation(tick: Tick) -> str:
    """Write moc_tick.c: CasADi's functions, kept static, and the interface around them."""
    return render(
        "moc_tick.c", **_interface(tick), rows=tick.rows, solves=any(field.name == "x" for field in tick.layout.report),
        observed=OBSERVED, generated=_generated(tick.start, tick.tick),
    )  # fmt: skip


def arm(tick: Tick) -> str:
    """Write moc_arm.c: gravity torque and tool pose, for the safety filter."""
    return render("moc_arm.c", generated=_generated(tick.gravity, tick.tool_pose))


def recording(rows: Recording) -> str:
    """Write recording.h: the recorded ticks as one table."""
    return render("recording.h", table=_table(rows))


def safe_recording(rows: SafeRecording) -> str:
    """Write safe_recording.h: the same for the controller behind its safety filter."""
    return render(
        "safe_recording.h", table=_table(rows[:-2]), applied=rows.applied.tolist(), stopped_at=rows.stopped_at
    )


def makefile(names: Collection[str], flags: str, tested: bool) -> str:
    """Write the Makefile for files of these names; `tested`: with the recorded run of the whole controller."""
    parts, headers = (sorted(n for n in names if n.startswith("moc_") and n.endswith(end)) for end in (".c", ".h"))
    tests = ["moc_tick_test", *(["moc_safe_test"] if tested else [])]
    udp = "udp.c" in names
    return render("Makefile", flags=flags, parts=parts, headers=headers, tests=tests, udp=udp)


def number(value: float | None) -> str:
    """Write a number to the last bit; None is no level, or no limit, at all."""
    if value is None:
        return "HUGE_VAL"
    if np.isnan(value):
        return "NAN"
    return repr(float(value)) if np.isfinite(value) else "HUGE_VAL" if value > 0.0 else "-HUGE_VAL"


def render(name: str, **values: Any) -> str:
    """Fill the template ``c/NAME.in``; a value of the template that is missing is an error."""
    return _environment().get_template(f"{name}.in").render(**values)


@cache
def _environment() -> Environment:
    # {{ }} would clash with C's braces.
    environment = Environment(
        loader=PackageLoader("moc_opt.embedded", "c"), undefined=StrictUndefined, keep_trailing_newline=True,
        trim_blocks=True, lstrip_blocks=True, variable_start_string="@{", variable_end_string="}",
    )  # fmt: skip
    environment.filters |= {
        "number": number,
        "numbers": lambda values: ", ".join(map(number, values)),
        "address": lambda field, owner: f"{'' if field.shape else '&'}{owner}{field.name}",
    }
    return environment


def _interface(tick: Tick) -> dict[str, Any]:
    names = [field.name for field in tick.layout.inputs]
    return {"n": tick.n, "names": names, **tick.layout._asdict()}


def _generated(*functions: Any) -> str:
    generator = ca.CodeGenerator("moc_casadi", {"with_mem": False})
    for function in functions:
        generator.add(function)
    text: str = generator.dump()
    return text.strip()


def _table(columns: tuple[Array, ...]) -> list[list[float]]:
    rows: list[list[float]] = np.hstack([np.asarray(part).reshape(len(columns[0]), -1) for part in columns]).tolist()
    return rows
