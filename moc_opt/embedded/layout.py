"""Inputs and outputs of a generated tick: names, sizes and meanings, defined once.

The header's arguments and structs, the order of CasADi's inputs and outputs and the memory that Python
shares with the compiled library are all read off these tables.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from moc_opt.qp.problem import row_length


class Field(NamedTuple):
    """An array of doubles, row by row; a scalar where the shape is ()."""

    name: str
    shape: tuple[int, ...]
    meaning: str
    """meaning and unit, for the reader of the header"""

    @property
    def length(self) -> int:
        """Number of doubles."""
        return math.prod(self.shape)

    @property
    def declared(self) -> str:
        """Its declaration in C, without the type."""
        return f"{self.name}[{self.length}]" if self.shape else self.name

    @property
    def argument(self) -> str:
        """Its declaration as an argument that is read."""
        return f"const double {self.name}[{self.length}]"

    @property
    def described(self) -> str:
        """Shape and meaning, for a comment."""
        return f"{self.shape} ".replace(" ", "") + " " + self.meaning if self.shape else self.meaning


class Layout(NamedTuple):
    """The arguments of one law on one arm."""

    inputs: tuple[Field, ...]
    state: tuple[Field, ...]
    """carried from tick to tick"""
    report: tuple[Field, ...]
    """optional output"""


OBSERVED = 2
"""So many of the state's fields come from the generated equations; the rest is set by the C code around them."""


def layout(n: int, law: str, rows: int) -> Layout:
    """List the arguments for n joints under law "moc" or "dcac" with so many rows of null space (0: none is used)."""
    inputs = (
        Field("q", (n,), "measured joint position [rad]"),
        Field("v", (n,), "measured joint velocity [rad/s]"),
        Field("tip_ref", (3, 3), "rows X_d [m], dX_d [m/s], ddX_d [m/s^2]: tip reference, world axes"),
        Field("trocar", (2, 3), "rows P_t [m], dP_t [m/s]: trocar as registered, world axes"),
    )
    state = (
        Field("momentum", (n,), "integral of the momentum observer [Nm s]"),
        Field("external_torque", (n,), "what the observer makes of the torque from outside [Nm]"),
        Field("torque", (n,), "torque of the last tick [Nm]; overwrite it if another one was applied"),
        Field("held_x", (n,), "last answer of the subproblem [rad/s]"),
        Field("share", (), "of the third level that is let through, growing to 1 over ramp_s"),
    )
    report: tuple[Field, ...] = (
        Field("mu", (), "manipulability [m^3]"),
        Field("grad_mu", (n,), "gradient of mu [m^3/rad]"),
        Field("tip", (3,), "tool tip X [m], world axes"),
        Field("wrist", (3,), "wrist centre N [m], world axes"),
        Field("M", (n, n), "joint-space inertia, rotor inertia included [kg m^2]"),
        Field("h", (n,), "C v + g [Nm]"),
        Field("energy_slope", (n,), "dT/dq, slope of the kinetic energy [Nm]"),
        Field("gravity", (n,), "torque that carries the arm's weight [Nm]"),
        Field("levels", (n,), "torque of levels 1 and 2: tip and RCM [Nm]"),
    )
    if rows:
        report += (Field("null_space", (rows, n), "orthonormal rows that move neither tip nor wrist"),)
    if rows and law == "dcac":
        report += (Field("A", (6, n), "Jacobians of tip and wrist"),)
    if law == "moc":
        report += (
            Field("x", (n,), "joint velocity that the third level followed [rad/s]"),
            Field("dual", (6,), "multipliers of the rows of tip and wrist; no meaning under a fallback"),
            Field("subproblem", (row_length(n),), "A (6,n), b (6,), grad_mu, lower, upper (n,), weights (4,), q (n,)"),
        )
    return Layout(inputs, state, report)
