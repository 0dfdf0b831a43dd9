"""Chatter and oscillation."""

from __future__ import annotations

import numpy as np

from moc_opt.errors import TraceError
from moc_opt.trace.metrics.registry import floats, lengths, metric
from moc_opt.trace.oscillation import shaking
from moc_opt.trace.trace import MissingDataError, Trace


@metric("Nm/s")
def torque_rate_rms_Nm_per_s(trace: Trace) -> float:
    """Chatter: root mean square over the ticks of |tau_k - tau_(k-1)| / (t_k - t_(k-1)) [Nm/s]."""
    change, step = lengths(np.diff(trace.tau_Nm, axis=0)), np.diff(floats(trace, "t_s"))
    if "tick" in trace.columns:
        # The ticks of one phase may lie apart; a difference across such a gap is no rate.
        together = np.diff(trace.tick) == 1
        change, step = change[together], step[together]
    if step.size == 0:
        raise MissingDataError("the trace has no two consecutive ticks: a torque rate needs them")
    if not (step > 0.0).all():
        raise TraceError("column 't_s' does not increase from tick to tick: give the time of each tick")
    return np.sqrt(np.mean((change / step) ** 2))


@metric("rad/s")
def oscillation_rad_per_s(trace: Trace) -> float:
    """Largest joint's root mean square of velocity above 8 Hz over a second [rad/s]; see moc_opt.trace.oscillation."""
    return shaking(trace, "v_rad_per_s").rms


@metric("Nm")
def oscillation_Nm(trace: Trace) -> float:
    """Largest joint's root mean square of torque above 8 Hz over a second [Nm]; see moc_opt.trace.oscillation."""
    return shaking(trace, "tau_Nm").rms
