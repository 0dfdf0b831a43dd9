"""Metrics of a run. To add a metric, write a function under `@metric`."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError, describe, shown
from moc_opt.inputs import plugins
from moc_opt.trace.columns import COLUMNS
from moc_opt.trace.meta import Ending
from moc_opt.trace.oscillation import shaking
from moc_opt.trace.trace import MissingDataError, Trace

Floats = NDArray[np.float64]
GROUP = "moc_opt.metrics"
_LOADED: dict[EntryPoint, str] = {}  # for each entry point tried so far: why loading failed, or ""


@dataclass(frozen=True)
class Metric:
    """A registered metric."""

    name: str
    unit: str  #: such as "mm"; "1" for counts and ratios
    about: str  #: one line on what the metric measures
    function: Callable[..., float] = field(repr=False)  #: function of (trace) or (trace, baseline)

    def __call__(self, trace: Trace, baseline: Trace | None = None) -> float:
        """Return the value. Raise a MissingDataError if the trace lacks the data."""
        compares = len(inspect.signature(self.function).parameters) > 1
        return float(self.function(trace, baseline) if compares else self.function(trace))


METRICS: dict[str, Metric] = {}  #: All metrics by name.


def metric(unit: str | Callable[..., float]) -> Any:
    """Register a function as a metric under its own name: `@metric("mm")`, or `@metric` for counts and ratios.

    The function takes `(trace)` or `(trace, baseline)`. The first line of its docstring describes the metric. If it
    raises a MissingDataError, a summary leaves the metric out.

    Raises:
        TraceError: the function has no docstring, or another metric already has its name.
    """
    if not callable(unit):
        return lambda function: _add(function.__name__, unit, inspect.getdoc(function) or "", function)
    return _add(unit.__name__, "1", inspect.getdoc(unit) or "", unit)


def _add(name: str, unit: str, about: str, function: Callable[..., float]) -> Metric:
    if not about:
        raise TraceError(f"metric {name!r} has no docstring: say in one line what it measures")
    known = METRICS[name].function if name in METRICS else function
    # A reloaded module may register its own metrics again.
    if (known.__module__, known.__qualname__) != (function.__module__, function.__qualname__):
        raise TraceError(f"metric {name!r} already exists in {known.__module__}: choose another name")
    METRICS[name] = Metric(name, unit, about.splitlines()[0], function)
    return METRICS[name]


def load_plugins() -> dict[str, str]:
    """Register the metrics of other packages. Return {name: reason} for those that cannot be loaded."""
    for name, points in plugins.plugins(GROUP).items():
        if points[0] in _LOADED:
            continue
        _LOADED[points[0]] = ""
        try:
            found = plugins.load("metric", name, points, TraceError)
            if isinstance(found, Metric):
                METRICS.setdefault(found.name, found)
            elif callable(found):
                metric(found)
            else:
                raise TraceError(f"metric {name!r}: {plugins.in_words(points[0])} is no function")
        except TraceError as error:
            _LOADED[points[0]] = str(error)
            warnings.warn(str(error), UserWarning, stacklevel=3)
    return {point.name: reason for point, reason in _LOADED.items() if reason}


def summarize(trace: Trace, baseline: Trace | None = None) -> dict[str, float]:
    """Compute every metric for which the trace has the data.

    Args:
        baseline: a run under DCAC (the controller without level 3) with the same gains, trial and ticks.

    Raises:
        TraceError: an argument is not a Trace or is empty, the ticks differ, or a column holds impossible numbers.
    """
    return evaluate(trace, baseline)[0]


def evaluate(trace: Trace, baseline: Trace | None = None) -> tuple[dict[str, float], dict[str, str]]:
    """Return the summary, and the reason for each metric without data."""
    load_plugins()
    for role, run in (("trace", trace), ("baseline", baseline)):
        if not isinstance(run, Trace) and (run is not None or role == "trace"):
            raise TraceError(f"the {role} is {shown(run)}: give a Trace, such as load_trace(path)")
        if run is not None and len(run) == 0:
            raise TraceError(f"the {role} is empty: run the scenario for at least one tick")
    if baseline is not None and not _same_ticks(trace, baseline):
        raise TraceError(
            f"the baseline has {_extent(baseline)}, but the trace has {_extent(trace)}: both are compared tick by "
            "tick; cut the longer one with head(ticks) or between(start_s, stop_s)"
        )
    summary, lacking = {}, {}
    for name, function in METRICS.items():
        try:
            summary[name] = function(trace, baseline)
        except MissingDataError as error:
            lacking[name] = describe(error)
        except Exception as error:
            why = f"metric {name!r} cannot be computed ({describe(error)})"
            if function.function.__module__ != __name__:
                warnings.warn(f"{why}: the summary leaves it out. It is defined in {function.function.__module__}",
                              UserWarning, stacklevel=3)  # fmt: skip
            elif isinstance(error, ArithmeticError):
                raise TraceError(f"{why}: a column that the metric reads holds zeros or impossible numbers") from error
            else:
                raise
    return summary, lacking


def _same_ticks(trace: Trace, baseline: Trace) -> bool:
    times, others = (run.columns.get("t_s") for run in (trace, baseline))
    if len(trace) != len(baseline) or times is None or others is None:
        return len(trace) == len(baseline)
    return bool(np.allclose(times, others, rtol=0.0, atol=1e-6))


def _extent(trace: Trace) -> str:
    times = trace.columns.get("t_s")
    return f"{len(trace)} ticks" + ("" if times is None else f" from {times[0]:.3f} to {times[-1]:.3f} s")


def _floats(trace: Trace, column: str) -> Floats:
    values = np.asarray(getattr(trace, column), dtype=np.float64)
    return values if values.ndim == 1 else _lengths(values)


def _lengths(rows: Floats) -> Floats:
    return np.asarray(np.sqrt((rows * rows).sum(axis=1)), dtype=np.float64)


def _known(trace: Trace, column: str) -> Floats:
    values = _floats(trace, column)
    values = values[~np.isnan(values)]
    if values.size == 0:
        raise MissingDataError(f"column {column!r} is NaN at every tick: there was nothing to measure")
    return values


def _count(flags: NDArray[Any]) -> float:
    return float(np.count_nonzero(flags))


def _figure(
    name: str, unit: str, said: str, column: str, of: Callable[[Any], float],
    read: Callable[[Trace, str], Floats] = _floats,
) -> None:  # fmt: skip
    factor = 1e3 if unit == "mm" else 1.0
    meaning, _, _ = COLUMNS[column].meaning.partition(";")
    _add(name, unit, f"{said} {meaning}.", lambda trace: factor * of(read(trace, column)))


# --- how a run ended ---


@metric
def completed(trace: Trace) -> float:
    """1 if the run completed, 0 if it was stopped, ran away, oscillated or failed."""
    ended = trace.meta.get("ended")
    if not isinstance(ended, str):
        raise MissingDataError("meta has no 'ended': say how the run ended")
    if Ending.of(ended) is Ending.PART:
        raise MissingDataError("the trace is a part of a run: only the whole run tells whether it was completed")
    return Ending.of(ended) is Ending.COMPLETED


@metric
def share_of_run(trace: Trace) -> float:
    """Completed share of the planned run. If it is below 1, the other metrics describe only the completed part."""
    ticks, planned = trace.meta.get("ticks"), trace.meta.get("ticks_planned")
    if not isinstance(ticks, int) or not isinstance(planned, int) or planned < 1:
        raise MissingDataError("meta has no 'ticks' and 'ticks_planned': give both as numbers of ticks")
    return ticks / planned


# --- manipulability ---


_figure("mu_mean", "m^3", "Mean", "mu", np.mean)
_figure("mu_final", "m^3", "Last", "mu", lambda values: values[-1])


@metric("percent")
def mu_gain_percent(trace: Trace, baseline: Trace | None) -> float:
    """Change of mean manipulability against the same run without level 3 (DCAC).

    DCAC runs with the observer gain of this run, which depends on `third_level`. So runs with different
    `third_level` have different baselines. Compare such runs by `mu_mean`.
    """
    if baseline is None:
        raise MissingDataError("there is no baseline: give the trace of DCAC on the same trial")
    reference = METRICS["mu_mean"](baseline)
    if reference == 0.0:
        raise MissingDataError("mu of the baseline is zero throughout: a change relative to zero has no value")
    return 100.0 * (METRICS["mu_mean"](trace) / reference - 1.0)


@metric
def mu_fraction_of_bound(trace: Trace) -> float:
    """Mean manipulability divided by the mean of the largest manipulability that the same tip and wrist allow."""
    bound = float(_known(trace, "mu_bound").mean())
    if bound == 0.0:
        raise MissingDataError("the largest mu is zero throughout: a fraction of zero has no value")
    return float(_floats(trace, "mu")[~np.isnan(trace.mu_bound)].mean()) / bound


@metric
def mu_fraction_of_best_from_start(trace: Trace) -> float:
    """Mean manipulability divided by its mean along the best joint motion from the same start."""
    return METRICS["mu_mean"](trace) / _known(trace, "mu_best_from_start").mean()


@metric
def mu_fraction_of_best(trace: Trace) -> float:
    """Mean manipulability divided by its mean along the best joint motion for the same tip and wrist from any start."""
    return METRICS["mu_mean"](trace) / _known(trace, "mu_best").mean()


# --- errors of tip and RCM; force of the trocar ---


for _column, _unit in (
    ("tip_error_model_m", "mm"), ("tip_error_registered_m", "mm"), ("tip_error_m", "mm"), ("rcm_error_model_m", "mm"),
    ("rcm_error_registered_m", "mm"), ("rcm_error_m", "mm"), ("trocar_force_N", "N"),
):  # fmt: skip
    for _word, _said, _of in (("mean", "Mean", np.mean), ("max", "Largest", np.max)):
        _figure(f"{_column.rpartition('_')[0]}_{_word}_{_unit}", _unit, _said, _column, _of)


# --- chatter and oscillation ---


@metric("Nm/s")
def torque_rate_rms_Nm_per_s(trace: Trace) -> float:
    """Chatter: root mean square rate of change of the joint torque vector."""
    change, step = _lengths(np.diff(trace.tau_Nm, axis=0)), np.diff(_floats(trace, "t_s"))
    if "tick" in trace.columns:
        together = np.diff(trace.tick) == 1
        change, step = change[together], step[together]
    if step.size == 0:
        raise MissingDataError("the trace has no two consecutive ticks: a torque rate needs them")
    if not (step > 0.0).all():
        raise TraceError("column 't_s' does not increase from tick to tick: give the time of each tick")
    return np.sqrt(np.mean((change / step) ** 2))


@metric("rad/s")
def oscillation_rad_per_s(trace: Trace) -> float:
    """Largest oscillation of a joint velocity: root mean square, over one second, of its part above 8 Hz."""
    return shaking(trace, "v_rad_per_s").rms


@metric("Nm")
def oscillation_Nm(trace: Trace) -> float:
    """Largest oscillation of a joint torque: root mean square, over one second, of its part above 8 Hz."""
    return shaking(trace, "tau_Nm").rms


# --- the solver ---


for _column in ("solve_us", "tick_us"):
    for _q, _said in ((50, "Median"), (99, "99th percentile of the")):
        _figure(f"{_column[:-3]}_p{_q}_us", "us", _said, _column, partial(np.percentile, q=_q), _known)


@metric
def deadline_misses(trace: Trace) -> float:
    """Number of ticks that took longer than deadline_us (default: 2000 us)."""
    deadline = trace.meta.get("deadline_us")
    if deadline is None:
        raise MissingDataError("meta has no 'deadline_us': give the time a tick may take [us]")
    if isinstance(deadline, bool) or not isinstance(deadline, (int, float)) or deadline <= 0.0:
        raise TraceError(f"meta['deadline_us'] = {deadline!r}: give a positive number of microseconds")
    return _count(trace.tick_us > deadline)


@metric
def claimed_solved(trace: Trace) -> float:
    """Number of answers that the solver reported as optimal."""
    return _count(trace.status == "solved")


@metric
def verified_solved(trace: Trace) -> float:
    """Number of answers that the check found optimal, whatever the solver reported."""
    return _count(trace.verified)


@metric
def silently_wrong(trace: Trace) -> float:
    """Number of answers that the solver reported as optimal, but the check found wrong."""
    return _count((trace.status == "solved") & ~trace.verified)


@metric
def faults(trace: Trace) -> float:
    """Number of control periods in which the solver's answer was refused or missing."""
    return _count((trace.fault != "none") & (trace.fault != "stopped"))


@metric
def limited_ticks(trace: Trace) -> float:
    """Number of control periods in which the safety filter changed the torque."""
    return _count(trace.limited)


for _column, _unit in (("primal", "rad/s, m/s"), ("natural", "rad/s"), ("loss", "1")):
    _figure(f"{_column}_max", _unit, "Largest", _column, np.max, _known)
