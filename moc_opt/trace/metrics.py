"""From a trace to numbers: one function per metric, the unit in its name.

A new metric is one function under `@metric`; its name is the key in every summary, its docstring the
documentation. It reads the columns it needs; a trace without them is summarized without it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError, UnknownNameError
from moc_opt.trace.ending import Ending
from moc_opt.trace.oscillation import shaking
from moc_opt.trace.trace import MissingDataError, Trace

Floats = NDArray[np.float64]
Phase = Literal["travelling", "settled"]
PHASES = ("travelling", "settled")


class Metric(Protocol):
    """A registered metric."""

    __doc__: str | None

    def __call__(self, trace: Trace, baseline: Trace | None = None) -> float:
        """Return the number; MissingDataError where the trace lacks what it takes, TraceError where empty."""


METRICS: dict[str, Metric] = {}
"""Name -> metric, in the order of a summary."""


def metric(function: Callable[..., float]) -> Metric:
    """Register a metric under its function's name.

    Args:
        function: `(trace) -> number` or `(trace, baseline) -> number`, with a docstring that says what it
            measures. It raises MissingDataError, as the access to an absent column does, to be left out.

    Raises:
        TraceError: it has no docstring, or another function has its name already.
    """
    name = function.__name__
    if not (function.__doc__ or "").strip():
        raise TraceError(f"metric {name!r} has no docstring: say in one line what it measures")
    known = inspect.unwrap(METRICS[name]) if name in METRICS else function
    # A module that is loaded a second time may bring its own metrics again.
    if (known.__module__, known.__qualname__) != (function.__module__, function.__qualname__):
        raise TraceError(f"metric {name!r} is there already, from {known.__module__}: choose another name")
    compares = len(inspect.signature(function).parameters) > 1

    @wraps(function)
    def measured(trace: Trace, baseline: Trace | None = None) -> float:
        for role, run in (("trace", trace), ("baseline", baseline)):
            if run is not None and len(run) == 0:
                raise TraceError(f"the {role} is empty: {name} needs at least one tick")
        return float(function(trace, baseline) if compares else function(trace))

    METRICS[name] = measured
    return measured


def summarize(trace: Trace, baseline: Trace | None = None, phase: Phase | None = None) -> dict[str, float]:
    """Compute every metric that the trace has the data for.

    Args:
        trace: a run.
        baseline: the run to compare with: DCAC with the same gains on the same trial.
        phase: only the ticks while the elbow is "travelling" to its optimum, or has "settled", by the trace's
            column `travelling`; the baseline is then read at the same ticks.

    Returns:
        Name -> number, in the order of METRICS; metrics whose data are absent are left out. Empty when the
        run has no tick in that phase.

    Raises:
        TraceError: the trace or the baseline is empty; a phase is asked for and the trace has no column
            `travelling`, or the baseline has not the same number of ticks.
        UnknownNameError: no such phase.
    """
    for role, run in (("trace", trace), ("baseline", baseline)):
        if run is not None and len(run) == 0:
            raise TraceError(f"the {role} is empty: run the scenario for at least one tick")
    if phase is not None:
        if phase not in PHASES:
            raise UnknownNameError("phase", phase, PHASES)
        ticks = trace.travelling if phase == "travelling" else ~trace.travelling
        if baseline is not None and len(baseline) != len(trace):
            raise TraceError(
                f"the baseline has {len(baseline)} ticks where the trace has {len(trace)}: "
                f"a phase is compared at the same ticks, give a baseline of the same trial"
            )
        if not ticks.any():
            return {}
        trace, baseline = trace.select(ticks), None if baseline is None else baseline.select(ticks)
    summary = {}
    for name, function in METRICS.items():
        try:
            summary[name] = function(trace, baseline)
        except MissingDataError:
            # By contract: a metric without its data has no number, and no key.
            continue
    return summary


def _floats(trace: Trace, column: str) -> Floats:
    """A column of numbers; of vectors, their lengths."""
    values = np.asarray(getattr(trace, column), dtype=np.float64)
    return values if values.ndim == 1 else _lengths(values)


def _known(trace: Trace, column: str) -> Floats:
    """The entries of a column that are not NaN; there must be one."""
    values = _floats(trace, column)
    values = values[~np.isnan(values)]
    if values.size == 0:
        raise MissingDataError(f"column {column!r} is NaN at every tick: there was nothing to measure")
    return values


def _lengths(rows: Floats) -> Floats:
    """Euclidean length of each row."""
    return np.asarray(np.sqrt((rows * rows).sum(axis=1)), dtype=np.float64)


@metric
def completed(trace: Trace) -> float:
    """1 where the run ended "completed", 0 where it was stopped, ran away or oscillated."""
    ended = trace.meta.get("ended")
    if not isinstance(ended, str):
        raise MissingDataError("meta has no 'ended': say how the run ended")
    return float(Ending.of(ended) is Ending.COMPLETED)


@metric
def share_of_run(trace: Trace) -> float:
    """Share of the planned ticks that the run came to: below 1 its other figures are those of a part."""
    ticks, planned = trace.meta.get("ticks"), trace.meta.get("ticks_planned")
    if not isinstance(ticks, int) or not isinstance(planned, int) or planned < 1:
        raise MissingDataError("meta has no 'ticks' and 'ticks_planned': give both as numbers of ticks")
    return ticks / planned


@metric
def mu_mean(trace: Trace) -> float:
    """Mean manipulability over the ticks [m^3]."""
    return float(_floats(trace, "mu").mean())


@metric
def mu_final(trace: Trace) -> float:
    """Manipulability at the last tick [m^3]."""
    return float(_floats(trace, "mu")[-1])


@metric
def mu_gain_percent(trace: Trace, baseline: Trace | None) -> float:
    """Mean manipulability above that of the baseline [percent of the baseline's]."""
    if baseline is None:
        raise MissingDataError("mu_gain_percent needs a baseline: give the trace of DCAC on the same trial")
    reference = mu_mean(baseline)
    if reference == 0.0:
        raise MissingDataError("the baseline is singular throughout: a gain over zero has no value")
    return 100.0 * (mu_mean(trace) / reference - 1.0)


@metric
def mu_fraction_of_bound(trace: Trace) -> float:
    """Mean manipulability over that of the largest on the feasible self-motion, where scanned."""
    bound = float(_known(trace, "mu_bound").mean())
    return float(_floats(trace, "mu")[~np.isnan(trace.mu_bound)].mean()) / bound


@metric
def tip_error_mean_mm(trace: Trace) -> float:
    """Mean distance of the tip from its reference in the base frame: absolute accuracy [mm]."""
    return 1e3 * float(_floats(trace, "tip_error_m").mean())


@metric
def tip_error_max_mm(trace: Trace) -> float:
    """Largest distance of the tip from its reference in the base frame: absolute accuracy [mm]."""
    return 1e3 * float(_floats(trace, "tip_error_m").max())


@metric
def tip_error_registered_mean_mm(trace: Trace) -> float:
    """Mean distance of the tip from its reference, both in the frame registered at the start [mm]."""
    return 1e3 * float(_floats(trace, "tip_error_registered_m").mean())


@metric
def tip_error_registered_max_mm(trace: Trace) -> float:
    """Largest distance of the tip from its reference, both in the frame registered at the start [mm]."""
    return 1e3 * float(_floats(trace, "tip_error_registered_m").max())


@metric
def tip_error_model_mean_mm(trace: Trace) -> float:
    """Mean distance of the tip from its reference by the robot's own kinematics, which its controller sees [mm]."""
    return 1e3 * float(_floats(trace, "tip_error_model_m").mean())


@metric
def tip_error_model_max_mm(trace: Trace) -> float:
    """Largest distance of the tip from its reference by the robot's own kinematics [mm]."""
    return 1e3 * float(_floats(trace, "tip_error_model_m").max())


@metric
def rcm_error_mean_mm(trace: Trace) -> float:
    """Mean distance of the shaft's line from the true trocar [mm]; the registration's error is part of it."""
    return 1e3 * float(_floats(trace, "rcm_error_m").mean())


@metric
def rcm_error_max_mm(trace: Trace) -> float:
    """Largest distance of the shaft's line from the trocar [mm]."""
    return 1e3 * float(_floats(trace, "rcm_error_m").max())


@metric
def rcm_error_registered_mean_mm(trace: Trace) -> float:
    """Mean distance of the true shaft's line from the trocar as registered by touch [mm]."""
    return 1e3 * float(_floats(trace, "rcm_error_registered_m").mean())


@metric
def rcm_error_registered_max_mm(trace: Trace) -> float:
    """Largest distance of the true shaft's line from the trocar as registered by touch [mm]."""
    return 1e3 * float(_floats(trace, "rcm_error_registered_m").max())


@metric
def rcm_error_model_mean_mm(trace: Trace) -> float:
    """Mean distance of the shaft from the registered trocar by the robot's own kinematics [mm]."""
    return 1e3 * float(_floats(trace, "rcm_error_model_m").mean())


@metric
def rcm_error_model_max_mm(trace: Trace) -> float:
    """Largest distance of the shaft from the registered trocar by the robot's own kinematics [mm]."""
    return 1e3 * float(_floats(trace, "rcm_error_model_m").max())


@metric
def trocar_force_mean_N(trace: Trace) -> float:
    """Mean magnitude of the trocar's force on the shaft [N]."""
    return float(_floats(trace, "trocar_force_N").mean())


@metric
def trocar_force_max_N(trace: Trace) -> float:
    """Largest magnitude of the trocar's force on the shaft [N]."""
    return float(_floats(trace, "trocar_force_N").max())


@metric
def torque_rate_rms_Nm_per_s(trace: Trace) -> float:
    """Chatter: root mean square over the ticks of |tau_k - tau_(k-1)| / (t_k - t_(k-1)) [Nm/s]."""
    change, step = _lengths(np.diff(trace.tau_Nm, axis=0)), np.diff(_floats(trace, "t_s"))
    if "tick" in trace.columns:
        # The ticks of one phase may lie apart; a difference across such a gap is no rate.
        together = np.diff(trace.tick) == 1
        change, step = change[together], step[together]
    if step.size == 0:
        raise MissingDataError("the trace has no two consecutive ticks: a torque rate needs them")
    if not (step > 0.0).all():
        raise TraceError("column 't_s' does not increase from tick to tick: give the time of each tick")
    return float(np.sqrt(np.mean((change / step) ** 2)))


@metric
def oscillation_rad_per_s(trace: Trace) -> float:
    """Largest joint's root mean square of velocity above 8 Hz over a second [rad/s]; see moc_opt.trace.oscillation."""
    return shaking(trace, "v_rad_per_s").rms


@metric
def oscillation_Nm(trace: Trace) -> float:
    """Largest joint's root mean square of torque above 8 Hz over a second [Nm]; see moc_opt.trace.oscillation."""
    return shaking(trace, "tau_Nm").rms


@metric
def solve_p50_us(trace: Trace) -> float:
    """Median time of a solve [us]."""
    return float(np.percentile(_known(trace, "solve_us"), 50))


@metric
def solve_p99_us(trace: Trace) -> float:
    """99th percentile of the time of a solve [us]."""
    return float(np.percentile(_known(trace, "solve_us"), 99))


@metric
def tick_p50_us(trace: Trace) -> float:
    """Median time of a whole tick [us]."""
    return float(np.percentile(_known(trace, "tick_us"), 50))


@metric
def tick_p99_us(trace: Trace) -> float:
    """99th percentile of the time of a whole tick [us]."""
    return float(np.percentile(_known(trace, "tick_us"), 99))


@metric
def deadline_misses(trace: Trace) -> float:
    """Ticks that took longer than meta["deadline_us"]."""
    deadline = trace.meta.get("deadline_us")
    if deadline is None:
        raise MissingDataError("meta has no 'deadline_us': give the time a tick may take [us]")
    if isinstance(deadline, bool) or not isinstance(deadline, (int, float)) or deadline <= 0.0:
        raise TraceError(f"meta['deadline_us'] = {deadline!r}: give a positive number of microseconds")
    return float(np.count_nonzero(trace.tick_us > deadline))


@metric
def claimed_solved(trace: Trace) -> float:
    """Ticks at which the solver claimed to have solved the subproblem."""
    return float(np.count_nonzero(trace.status == "solved"))


@metric
def verified_solved(trace: Trace) -> float:
    """Ticks at which the answer was judged optimal, whatever the solver claimed."""
    return float(np.count_nonzero(trace.verified))


@metric
def silently_wrong(trace: Trace) -> float:
    """Ticks at which the solver claimed success and the answer was judged wrong."""
    return float(np.count_nonzero((trace.status == "solved") & ~trace.verified))


@metric
def faults(trace: Trace) -> float:
    """Ticks at which the third level's answer was refused or missing, for whatever reason."""
    return float(np.count_nonzero((trace.fault != "none") & (trace.fault != "stopped")))


@metric
def limited_ticks(trace: Trace) -> float:
    """Ticks at which the guard changed the torque that was asked for."""
    return float(np.count_nonzero(trace.limited))


@metric
def primal_max(trace: Trace) -> float:
    """Largest max(|A x - b|_inf, box violation) over the subproblems [rad/s, m/s]."""
    return float(_known(trace, "primal").max())


@metric
def natural_max(trace: Trace) -> float:
    """Largest natural residual over the subproblems [rad/s]."""
    return float(_known(trace, "natural").max())


@metric
def loss_max(trace: Trace) -> float:
    """Largest share of the cost's range that an answer gave away: 0 at the optimum, 1 at the worst point."""
    return float(_known(trace, "loss").max())
