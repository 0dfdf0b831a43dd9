"""Time calls, measure the machine's load, and compute percentiles."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterable, Mapping
from time import perf_counter, perf_counter_ns, process_time
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.sim.loop import no_collector

PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
MOST_SWITCHES = 0.0025  # allowed involuntary context switches per call
LEAST_CPU_SHARE = 0.9

Row = Mapping[str, Any]
COUNTED = ("times_calls", "times_switches", "times_cpu_s", "times_wall_s")
"""The load while calls were timed. ``times_switches`` counts involuntary context switches, and ``times_cpu_s`` is the
processor time of all threads."""


def used() -> dict[str, float]:
    """Read the counters, for a later `since`."""
    switches = resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw
    return dict(zip(COUNTED, (0, switches, process_time(), perf_counter()), strict=True))


def since(before: Row, calls: int) -> dict[str, float]:
    """Return the `COUNTED` entries since ``before``."""
    return {name: value - before[name] for name, value in used().items()} | {"times_calls": calls}


def total(rows: Iterable[Row]) -> dict[str, float]:
    """Sum the `COUNTED` entries over rows."""
    rows = list(rows)
    return {name: sum((row.get(name, 0) for row in rows), 0.0) for name in COUNTED}


def cpu_share(row: Row) -> float:
    """Return processor time divided by wall time."""
    return float(row["times_cpu_s"] / row["times_wall_s"]) if row.get("times_wall_s") else 1.0


def quiet(row: Row) -> bool:
    """Tell whether the machine was so quiet that the 99th percentile can be trusted."""
    few = row.get("times_switches", 0) <= MOST_SWITCHES * row.get("times_calls", 0)
    return bool(few and cpu_share(row) >= LEAST_CPU_SHARE)


def load(rows: Iterable[Row]) -> str:
    """Describe the machine's load while times were measured. Return "" if no row has times."""
    timed = [row for row in rows if row.get("times_calls")]
    if not timed:
        return ""
    whole, spoilt = total(timed), sum(not quiet(row) for row in timed)
    if spoilt:
        return (
            f"In {spoilt} of {len(timed)} measurements of time, other programs used the machine. The p99 of these "
            f"{spoilt} is not reliable. On a quiet machine, run the same command again: it repeats only these {spoilt}."
        )
    return (
        f"While times were measured, the measuring process had {100.0 * cpu_share(whole):.1f} % of a core and was "
        f"interrupted {whole['times_switches']:,.0f} times in {whole['times_wall_s']:.2g} s: the machine was quiet."
    )


def clock_cost_us() -> float:
    """Return the median time between two readings of the clock [us]."""
    gaps = np.empty(2000)
    for i in range(len(gaps)):
        begin = perf_counter_ns()
        gaps[i] = perf_counter_ns() - begin
    return float(np.median(gaps) * 1e-3)


def each_us(
    call: Callable[[Any], Any], items: Iterable[Any], results: list[Any] | None = None,
    seen: list[dict[str, float]] | None = None,
) -> Array:  # fmt: skip
    """Time ``call(item)`` one by one [us], without garbage collection.

    ``results`` and ``seen`` collect the results and the machine's load.
    """
    times = []
    with no_collector():
        before = used()
        for item in items:
            begin = perf_counter_ns()
            result = call(item)
            times.append(perf_counter_ns() - begin)
            if results is not None:  # only on request, because keeping results lengthens the slowest calls
                results.append(result)
        if seen is not None:
            seen.append(since(before, len(times)))
    return np.array(times) * 1e-3


def percentiles(times: Array, prefix: str) -> dict[str, float]:
    """Return the percentiles of the finite times by name, such as prefix_p50_us."""
    times = times[np.isfinite(times)]
    if times.size == 0:
        return {}
    return {f"{prefix}_{name.replace('.', '_')}_us": float(np.percentile(times, q)) for name, q in PERCENTILES.items()}
