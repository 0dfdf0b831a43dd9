"""The columns of a trace, and checks of the arrays."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import read_only
from moc_opt.errors import TraceError


class Column(NamedTuple):
    """Unit, shape and meaning of a column."""

    unit: str
    shape: str
    meaning: str
    kind: str = "number"


COLUMNS: Mapping[str, Column] = MappingProxyType(
    {
        "t_s": Column("s", "(N,)", "time at the start of the tick (control period)"),
        "q_rad": Column("rad", "(N, n)", "true joint positions"),
        "v_rad_per_s": Column("rad/s", "(N, n)", "true joint velocities"),
        "tau_Nm": Column("Nm", "(N, n)", "joint torques sent to the arm, within the safety filter's limits"),
        "limited": Column("1", "(N,)", "number of joints whose torque the safety filter changed"),
        "tip_m": Column("m", "(N, 3)", "true tip X"),
        "tip_ref_m": Column("m", "(N, 3)", "tip reference X_d"),
        "wrist_m": Column("m", "(N, 3)", "true wrist centre N"),
        "trocar_m": Column("m", "(N, 3)", "true trocar P_t"),
        "trocar_registered_m": Column("m", "(N, 3)", "true position of the point that was registered as the trocar"),
        "force_N": Column("N", "(N, 3)", "force of the tool on its mount, as measured by the wrench sensor; tool axes"),
        "torque_Nm": Column("Nm", "(N, 3)", "moment of the tool on its mount, as measured; tool axes"),
        "mu": Column("m^3", "(N,)", "manipulability sqrt(det(J J^T)) of the tip Jacobian J"),
        "tip_error_m": Column("m", "(N,)", "distance of the tip from its reference, in the base frame"),
        "tip_error_registered_m": Column(
            "m", "(N,)", "size of the change of (tip - reference) since the start",
        ),
        "tip_error_model_m": Column(
            "m", "(N,)", "distance of the tip from its reference, by the robot's kinematic model",
        ),
        "rcm_error_m": Column("m", "(N,)", "distance of the shaft from the true trocar"),
        "rcm_error_registered_m": Column("m", "(N,)", "distance of the true shaft from the registered trocar"),
        "rcm_error_model_m": Column(
            "m", "(N,)", "distance of the shaft from the registered trocar, by the robot's kinematic model",
        ),
        "trocar_force_N": Column("N", "(N, 3)", "true force of the trocar on the shaft; world axes"),
        "x_rad_per_s": Column("rad/s", "(N, n)", "the solver's answer x to the subproblem (a QP); NaN: no answer"),
        "dual": Column("", "(N, k)", "multipliers y of the six equality rows; NaN if the solver gives none"),
        "subproblem": Column("", "(N, k)", "the subproblem's packed numbers; see `NullSpaceQP.from_row`"),
        "iterations": Column("1", "(N,)", "number of iterations of the solver; 0 if it does not iterate"),
        "status": Column("", "(N,)", "status claimed by the solver; 'none' without a third level", "text"),
        "applied_x_rad_per_s": Column(
            "rad/s", "(N, n)", "the x that the third level (elbow motion) followed: the answer or its substitute",
        ),
        "fault": Column(
            "", "(N,)", "why the answer was refused (control.supervisor.Fault); 'stopped' during a stop", "text",
        ),
        "injected": Column("", "(N,)", "this answer was falsified on purpose, to test the supervisor", "flag"),
        "solve_us": Column("us", "(N,)", "time to solve the subproblem; NaN without a subproblem"),
        "tick_us": Column("us", "(N,)", "computation time of a control period, from state to torque"),
        "tick": Column("1", "(N,)", "index of the tick; without this column, rows are consecutive ticks"),
        "travelling": Column("", "(N,)", "the elbow is still moving to its optimum", "flag"),
        "verified": Column("", "(N,)", "the answer was judged optimal", "flag"),
        "primal": Column("rad/s, m/s", "(N,)", "violation of A x = b or of a bound on x; NaN without a subproblem"),
        "natural": Column("rad/s", "(N,)", "KKT residual (natural map) of x and `dual`; NaN without a subproblem"),
        "natural_best": Column("rad/s", "(N,)", "the same residual with the best multipliers for x instead of `dual`"),
        "relative": Column("rad/s", "(N,)", "natural_best after the cost is divided by its slope (see `Residuals`)"),
        "distance": Column("rad/s", "(N,)", "largest difference of an entry of x from the nearest optimum"),
        "loss": Column("1", "(N,)", "(cost - smallest cost) / (largest - smallest cost) of the feasible x"),
        "mu_bound": Column("m^3", "(N,)", "largest mu of all feasible poses with this tip and wrist; NaN if unknown"),
        "mu_best_from_start": Column("m^3", "(N,)", "mu along the best planned joint motion from the run's start"),
        "mu_best": Column("m^3", "(N,)", "mu along the best planned joint motion from any start pose"),
        "q_best_from_start_rad": Column("rad", "(N, n)", "best planned joint motion from the run's start"),
    }
)  # fmt: skip


def column(name: str, value: ArrayLike) -> NDArray[Any]:
    """Return a column as a read-only array. Raise a TraceError if the value is wrong."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TraceError(f"column {name!r} has rows of different lengths: give an array") from error
    if array.dtype == object and all(isinstance(entry, str) for entry in array.flat):
        array = array.astype(np.str_)
    dtype, shape, kind = array.dtype, array.shape, array.dtype.kind
    if not (kind in "Ubiu" or (kind == "f" and dtype.itemsize in (4, 8))):
        raise TraceError(f"column {name!r} has type {dtype}: give floats, integers, flags or texts")
    if len(shape) not in ((1,) if kind == "U" else (1, 2)) or shape[1:] == (0,):
        raise TraceError(f"column {name!r} has shape {shape}: give (N,) or, for numbers, (N, k)")
    known = COLUMNS.get(name)
    if known is not None:
        wanted = {"text": "U", "flag": "b"}.get(known.kind, "fiu")
        width = known.shape.removeprefix("(N,").strip(" )")
        fits = len(shape) == 1 if not width else len(shape) == 2 and width in ("n", "k", str(shape[1]))
        if kind not in wanted or not fits:
            raise TraceError(f"column {name!r} is {dtype} of shape {shape}: give {known.kind}s of shape {known.shape}")
    native = dtype.newbyteorder("=")
    if array.flags.writeable or not array.flags.owndata or dtype != native:
        array = np.array(array, dtype=native, order="C")
    return read_only(array)
