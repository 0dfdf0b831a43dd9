"""The C text around CasADi's generated functions: header, thin readable interface, self-test, Makefile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from moc_opt.embedded import templates
from moc_opt.embedded.layout import Field
from moc_opt.embedded.symbolic import Tick
from moc_opt.names import in_comment

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
    generator = ca.CodeGenerator("moc_casadi", {"with_mem": False})
    generator.add(tick.start)
    generator.add(tick.tick)
    names, state, report = tick.layout
    inputs = [field.name for field in names]
    return templates.IMPLEMENTATION.substitute(
        n=tick.n,
        generated=generator.dump().strip(),
        arguments=_arguments(tick.layout.inputs),
        start_arguments=_arguments(tick.layout.inputs[:2]),
        start_given=", ".join(inputs[:2]),
        start_results=", ".join(_address("state->", field) for field in state),
        given=", ".join([*inputs, *(_address("state->", field) for field in state)]),
        results=", ".join(_address("next.", field) for field in state),
        reported=",\n        ".join(f"report ? {_address('report->', field)} : NULL" for field in report),
        bad=" || ".join(f"not_finite({field.name}, {field.length})" for field in names),
    )


def self_test(tick: Tick) -> str:
    """main.c: compares with the recording and times itself."""
    return templates.MAIN.substitute(n=tick.n)


def recording(rows: Recording) -> str:
    """recording.h: the recorded ticks as one table."""
    table = np.hstack([np.asarray(part).reshape(len(rows.q), -1) for part in rows])
    lines = ",\n".join("    {" + ", ".join(map(repr, map(float, row))) + "}" for row in table)
    return templates.RECORDING.substitute(ticks=len(table), width=table.shape[1], rows=lines)


def makefile(flags: str) -> str:
    """Makefile with the flags that the package itself compiles with."""
    return templates.MAKEFILE.substitute(flags=flags)


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
