"""The registry of metrics: `@metric` registers a function, and `summarize` computes all that a trace allows."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError, UnknownNameError, describe, shown
from moc_opt.inputs import plugins
from moc_opt.trace.trace import MissingDataError, Trace

Floats = NDArray[np.float64]
Phase = Literal["travelling", "settled"]
PHASES = ("travelling", "settled")


@dataclass(frozen=True)
class Metric:
    """A registered metric: call it with a trace, and with a baseline where it compares two runs.

    Raises:
        MissingDataError: the trace lacks the data.
        TraceError: the trace or the baseline is empty.
    """

    name: str  #: key in every summary, with the unit in it
    unit: str  #: "mm", "us"; "1" for counts and shares
    about: str  #: one line on what it measures
    function: Callable[..., float] = field(repr=False)  #: `(trace) -> number` or `(trace, baseline) -> number`

    def __post_init__(self) -> None:
        object.__setattr__(self, "__doc__", inspect.getdoc(self.function))
        object.__setattr__(self, "__wrapped__", self.function)

    def __call__(self, trace: Trace, baseline: Trace | None = None) -> float:
        """Return the number."""
        for role, run in (("trace", trace), ("baseline", baseline)):
            if run is not None and len(run) == 0:
                raise TraceError(f"the {role} is empty: {self.name} needs at least one tick")
        compares = len(inspect.signature(self.function).parameters) > 1
        return float(self.function(trace, baseline) if compares else self.function(trace))


GROUP = "moc_opt.metrics"
METRICS: dict[str, Metric] = {}  #: Name -> metric, in the order of a summary.
_LOADED: dict[EntryPoint, str] = {}


def metric(unit: str | Callable[..., float]) -> Any:
    """Register a function as a metric under its own name: `@metric("mm")`, or `@metric` for counts and shares.

    The function takes `(trace)` or `(trace, baseline)` and has a docstring whose first line describes it. If it
    raises MissingDataError, as the access to an absent column does, a summary leaves it out.

    Raises:
        TraceError: it has no docstring, or another function has its name already.

    Example:
        >>> from moc_opt.trace.metrics import metric
        >>> @metric("rad/s")
        ... def fastest_joint_rad_per_s(trace):
        ...     "Largest speed of any joint."
        ...     return abs(trace.v_rad_per_s).max()
        >>> fastest_joint_rad_per_s.unit
        'rad/s'
    """
    if callable(unit):
        return register("1", unit)
    return lambda function: register(unit, function)


def register(unit: str, function: Callable[..., float], name: str = "", about: str = "") -> Metric:
    """Register a function under its own name and docstring, or under others."""
    if name:
        function.__name__, function.__qualname__, function.__doc__ = name, name, about
    name, about = function.__name__, inspect.getdoc(function) or ""
    if not about:
        raise TraceError(f"metric {name!r} has no docstring: say in one line what it measures")
    known = METRICS[name].function if name in METRICS else function
    # A module that is loaded a second time may bring its own metrics again.
    if (known.__module__, known.__qualname__) != (function.__module__, function.__qualname__):
        raise TraceError(f"metric {name!r} is there already, from {known.__module__}: choose another name")
    METRICS[name] = Metric(name, unit, about.splitlines()[0], function)
    return METRICS[name]


def load_plugins() -> dict[str, str]:
    """Register the metrics of other packages; return name -> reason for those that cannot be loaded."""
    for name, points in plugins.plugins(GROUP, entry_points).items():
        if points[0] in _LOADED:
            continue
        _LOADED[points[0]] = ""
        try:
            found = plugins.load("metric", name, points, TraceError)
            if isinstance(found, Metric):
                METRICS.setdefault(found.name, found)
            elif callable(found):
                register("1", found)
            else:
                raise TraceError(f"metric {name!r}: {plugins.in_words(points[0])} is no function")
        except TraceError as error:
            _LOADED[points[0]] = str(error)
            warnings.warn(str(error), UserWarning, stacklevel=3)
    return {point.name: reason for point, reason in _LOADED.items() if reason}


def summarize(trace: Trace, baseline: Trace | None = None, phase: Phase | None = None) -> dict[str, float]:
    """Compute every metric that the trace has the data for.

    Args:
        baseline: the run to compare with: DCAC with the same gains on the same trial, over the same time.
        phase: only the ticks while the elbow is "travelling" to its optimum, or has "settled", by the trace's
            column `travelling`; the baseline is then read at the same ticks.

    Returns:
        Name -> number, in the order of METRICS, without those whose data are absent; empty where no tick is in that
        phase.

    Raises:
        TraceError: the trace or the baseline is none or empty, they are not of the same time, a column holds numbers
            that no run has, or the trace has no column `travelling` for a phase.
        UnknownNameError: no such phase.

    Example:
        >>> short = mo.Scenario(duration_s=0.1, bound_samples=0)
        >>> trace, baseline = mo.run(short), mo.run(short.change(control={"law": "dcac"}))
        >>> numbers = mo.summarize(trace, baseline)
        >>> numbers["verified_solved"], "mu_gain_percent" in numbers
        (50.0, True)
    """
    load_plugins()
    for role, run in (("trace", trace), ("baseline", baseline)):
        if not isinstance(run, Trace) and (run is not None or role == "trace"):
            raise TraceError(f"the {role} is {shown(run)}: give a Trace, such as load_trace(path)")
        if run is not None and len(run) == 0:
            raise TraceError(f"the {role} is empty: run the scenario for at least one tick")
    if baseline is not None and not _same_ticks(trace, baseline):
        raise TraceError(
            f"the baseline has {_extent(baseline)} where the trace has {_extent(trace)}: they are compared tick by "
            "tick; cut the longer one with head(ticks) or between(start_s, stop_s)"
        )
    if phase is not None:
        if not isinstance(phase, str) or phase not in PHASES:
            raise UnknownNameError("phase", str(phase), PHASES)
        ticks = trace.travelling if phase == "travelling" else ~trace.travelling
        if not ticks.any():
            return {}
        # Ending and share of the run belong to the whole run, not to a phase of it.
        trace = trace.select(ticks, as_part=False)
        baseline = None if baseline is None else baseline.select(ticks, as_part=False)
    summary = {}
    for name, function in METRICS.items():
        try:
            summary[name] = function(trace, baseline)
        except MissingDataError:
            continue  # a metric without its data has no number, and no key
        except ArithmeticError as error:
            raise TraceError(
                f"metric {name!r} cannot be computed ({describe(error)}): a column that it reads holds zeros, or "
                "numbers that no run has"
            ) from error
    return summary


def _same_ticks(trace: Trace, baseline: Trace) -> bool:
    times, others = (run.columns.get("t_s") for run in (trace, baseline))
    if len(trace) != len(baseline) or times is None or others is None:
        return len(trace) == len(baseline)
    return bool(np.allclose(times, others, rtol=0.0, atol=1e-6))


def _extent(trace: Trace) -> str:
    times = trace.columns.get("t_s")
    return f"{len(trace)} ticks" + ("" if times is None else f" from {times[0]:.3f} to {times[-1]:.3f} s")


def floats(trace: Trace, column: str) -> Floats:
    """Return a column of numbers; of vectors, their lengths."""
    values = np.asarray(getattr(trace, column), dtype=np.float64)
    return values if values.ndim == 1 else lengths(values)


def known(trace: Trace, column: str) -> Floats:
    """Return the entries of a column that are not NaN; there must be one."""
    values = floats(trace, column)
    values = values[~np.isnan(values)]
    if values.size == 0:
        raise MissingDataError(f"column {column!r} is NaN at every tick: there was nothing to measure")
    return values


def figure(
    name: str, column: str, unit: str, about: str, of: Callable[[Any], float],
    read: Callable[[Trace, str], Floats] = floats,
) -> Metric:  # fmt: skip
    """Register a figure ``of`` one column, which ``read`` takes out of the trace; metres are told in mm."""
    factor = 1e3 if unit == "mm" else 1.0
    return register(unit, lambda trace: factor * of(read(trace, column)), name, about)


def ticks_with(name: str, about: str, marked: Callable[[Trace], NDArray[Any]]) -> Metric:
    """Register the number of ticks that are marked."""
    return register("1", lambda trace: float(np.count_nonzero(marked(trace))), name, about)


def lengths(rows: Floats) -> Floats:
    """Return the Euclidean length of each row."""
    return np.asarray(np.sqrt((rows * rows).sum(axis=1)), dtype=np.float64)
