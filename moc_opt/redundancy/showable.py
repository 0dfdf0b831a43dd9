"""Whether a run can be shown on an arm: the columns, the joints and the numbers that a picture needs."""

from __future__ import annotations

import numpy as np

from moc_opt.errors import ReportError
from moc_opt.model.robot_model import RobotModel
from moc_opt.trace.trace import Trace

NEEDED = ("t_s", "q_rad", "tip_m", "tip_ref_m")


def check(name: str, trace: Trace, robot: RobotModel) -> None:
    """Raise where a run cannot be shown.

    Raises:
        ReportError: it is empty, lacks a column, is of another arm, or its poses are not finite.
    """
    missing = [column for column in NEEDED if column not in trace.columns]
    if missing or not len(trace):
        what = f"lacks the columns {', '.join(missing)}" if missing else "has no ticks"
        raise ReportError(f"run {name!r} {what}: give a trace as `run` leaves it")
    if trace.q_rad.shape[1] != robot.n:
        raise ReportError(
            f"run {name!r} has {trace.q_rad.shape[1]} joints, robot {robot.data.name!r} {robot.n}: give its own arm"
        )
    for column in NEEDED:
        if not np.isfinite(trace.columns[column]).all():
            raise ReportError(
                f"run {name!r} is not finite in {column!r}: cut it off before that with `select`"
            )
