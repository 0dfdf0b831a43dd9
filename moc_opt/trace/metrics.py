"""From a trace to numbers: one function per metric under `@metric`, in the order of a summary.

A new metric is one function; its name, with the unit in it, is the key in every summary. A summary of a trace that
lacks a column which it reads leaves it out.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from moc_opt.errors import TraceError
from moc_opt.trace.meta import Ending
from moc_opt.trace.oscillation import shaking
from moc_opt.trace.registry import (
    METRICS,
    PHASES,
    Metric,
    figure,
    floats,
    known,
    lengths,
    load_plugins,
    metric,
    summarize,
    ticks_with,
)  # fmt: skip
from moc_opt.trace.trace import MissingDataError, Trace

__all__ = ["METRICS", "PHASES", "Metric", "load_plugins", "metric", "summarize"]


# How a run ended.


@metric
def completed(trace: Trace) -> float:
    """1 where the run ended "completed", 0 where it was stopped, ran away or oscillated; a part of a run has none."""
    ended = trace.meta.get("ended")
    if not isinstance(ended, str):
        raise MissingDataError("meta has no 'ended': say how the run ended")
    if Ending.of(ended) is Ending.PART:
        raise MissingDataError("these are some ticks of a run: ask the whole run whether it was completed")
    return Ending.of(ended) is Ending.COMPLETED


@metric
def share_of_run(trace: Trace) -> float:
    """Share of the planned ticks that are in the trace: below 1 its other figures are those of a part."""
    ticks, planned = trace.meta.get("ticks"), trace.meta.get("ticks_planned")
    if not isinstance(ticks, int) or not isinstance(planned, int) or planned < 1:
        raise MissingDataError("meta has no 'ticks' and 'ticks_planned': give both as numbers of ticks")
    return ticks / planned


# Manipulability over a run.


@metric("m^3")
def mu_mean(trace: Trace) -> float:
    """Mean manipulability over the ticks [m^3]."""
    return floats(trace, "mu").mean()


mu_final = figure("mu_final", "mu", "m^3", "Manipulability at the last tick [m^3].", lambda values: values[-1])


@metric("percent")
def mu_gain_percent(trace: Trace, baseline: Trace | None) -> float:
    """Mean manipulability above the baseline's [percent of it]; compare two third levels by mu_mean.

    Their baselines differ: each has the observer gain of its third level.
    """
    if baseline is None:
        raise MissingDataError("mu_gain_percent needs a baseline: give the trace of DCAC on the same trial")
    reference = mu_mean(baseline)
    if reference == 0.0:
        raise MissingDataError("the baseline is singular throughout: a gain over zero has no value")
    return 100.0 * (mu_mean(trace) / reference - 1.0)


@metric
def mu_fraction_of_bound(trace: Trace) -> float:
    """Mean manipulability over that of the largest of all feasible poses, at the ticks where it was looked for."""
    bound = float(known(trace, "mu_bound").mean())
    if bound == 0.0:
        raise MissingDataError("the largest mu is zero throughout: a share of it has no value")
    return float(floats(trace, "mu")[~np.isnan(trace.mu_bound)].mean()) / bound


@metric
def mu_fraction_of_best_from_start(trace: Trace) -> float:
    """Mean manipulability over that of the best course from the same start, where planned."""
    return mu_mean(trace) / known(trace, "mu_best_from_start").mean()


@metric
def mu_fraction_of_best(trace: Trace) -> float:
    """Mean manipulability over that of the best course from any swivel and branch, where planned."""
    return mu_mean(trace) / known(trace, "mu_best").mean()


# Errors of tip and remote centre of motion (RCM), and the trocar's force: mean and largest of a column each.


def _mean_and_max(column: str, unit: str, about: str, of_mean: str = "") -> tuple[Metric, Metric]:
    stem = column.rpartition("_")[0]
    return (
        figure(f"{stem}_mean_{unit}", column, unit, f"Mean {about} [{unit}]{of_mean}.", np.mean),
        figure(f"{stem}_max_{unit}", column, unit, f"Largest {about} [{unit}].", np.max),
    )


tip_error_model_mean_mm, tip_error_model_max_mm = _mean_and_max(
    "tip_error_model_m", "mm", "distance of the tip from its reference by the robot's own kinematics",
    ", which its controller sees",
)  # fmt: skip
tip_error_registered_mean_mm, tip_error_registered_max_mm = _mean_and_max(
    "tip_error_registered_m", "mm", "distance of the tip from its reference, both in the frame registered at the start"
)
tip_error_mean_mm, tip_error_max_mm = _mean_and_max(
    "tip_error_m", "mm", "distance of the tip from its reference in the base frame: absolute accuracy"
)
rcm_error_model_mean_mm, rcm_error_model_max_mm = _mean_and_max(
    "rcm_error_model_m", "mm", "distance of the shaft from the registered trocar by the robot's own kinematics"
)
rcm_error_registered_mean_mm, rcm_error_registered_max_mm = _mean_and_max(
    "rcm_error_registered_m", "mm", "distance of the true shaft's line from the trocar as registered by touch"
)
rcm_error_mean_mm, rcm_error_max_mm = _mean_and_max(
    "rcm_error_m", "mm", "distance of the shaft's line from the true trocar", "; the registration's error is part of it"
)
trocar_force_mean_N, trocar_force_max_N = _mean_and_max(
    "trocar_force_N", "N", "magnitude of the trocar's force on the shaft"
)


# Chatter and oscillation.


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


# Times, claims, verdicts and residuals of the solver.


solve_p50_us, solve_p99_us, tick_p50_us, tick_p99_us = (
    figure(f"{what}_p{q}_us", f"{what}_us", "us", f"{words} time of a {of} [us].", partial(np.percentile, q=q), known)
    for what, of in (("solve", "solve"), ("tick", "whole tick"))
    for q, words in ((50, "Median"), (99, "99th percentile of the"))
)


@metric
def deadline_misses(trace: Trace) -> float:
    """Ticks that took longer than meta["deadline_us"]."""
    deadline = trace.meta.get("deadline_us")
    if deadline is None:
        raise MissingDataError("meta has no 'deadline_us': give the time a tick may take [us]")
    if isinstance(deadline, bool) or not isinstance(deadline, (int, float)) or deadline <= 0.0:
        raise TraceError(f"meta['deadline_us'] = {deadline!r}: give a positive number of microseconds")
    return float(np.count_nonzero(trace.tick_us > deadline))


claimed_solved = ticks_with(
    "claimed_solved", "Ticks at which the solver claimed to have solved the subproblem.",
    lambda trace: trace.status == "solved",
)  # fmt: skip
verified_solved = ticks_with(
    "verified_solved", "Ticks at which the answer was judged optimal, whatever was claimed.",
    lambda trace: trace.verified,
)  # fmt: skip
silently_wrong = ticks_with(
    "silently_wrong", "Ticks at which success was claimed and the answer was judged wrong.",
    lambda trace: (trace.status == "solved") & ~trace.verified,
)  # fmt: skip
faults = ticks_with(
    "faults", "Ticks at which the third level's answer was refused or missing, for any reason.",
    lambda trace: (trace.fault != "none") & (trace.fault != "stopped"),
)  # fmt: skip
limited_ticks = ticks_with(
    "limited_ticks", "Ticks at which the safety filter changed the torque asked for.", lambda trace: trace.limited
)
primal_max, natural_max, loss_max = (
    figure(f"{name}_max", name, unit, f"Largest {about} over the subproblems [{unit}].", np.max, known)
    for name, unit, about in (
        ("primal", "rad/s, m/s", "max(|A x - b|_inf, box violation)"),
        ("natural", "rad/s", "natural residual"),
        ("loss", "1", "share of the cost's range that an answer lost: 0 at the optimum, 1 at the worst point"),
    )
)
