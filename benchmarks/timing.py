"""The clock of every benchmark: what is timed, how, and which figures are quoted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.sim.loop import no_collector

Array = NDArray[np.float64]

PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}


def clock_cost_us(samples: int = 2000) -> float:
    """What reading the clock twice costs [us]; it is left inside every figure and reported beside them."""
    gaps = np.empty(samples)
    for i in range(samples):
        begin = perf_counter_ns()
        gaps[i] = perf_counter_ns() - begin
    return float(np.median(gaps) * 1e-3)


def each_us(call: Callable[[Any], Any], items: Iterable[Any], results: list[Any] | None = None) -> Array:
    """Time ``call(item)`` one by one [us], without garbage-collection pauses; results are kept if asked for."""
    times = []
    keep = results.append if results is not None else None
    with no_collector():
        for item in items:
            begin = perf_counter_ns()
            result = call(item)
            times.append(perf_counter_ns() - begin)
            if keep is not None:
                keep(result)
    return np.array(times) * 1e-3


def side_by_side(
    calls: dict[str, Callable[[Any], Any]], items: Sequence[Any], rounds: int = 5
) -> dict[str, Array]:
    """Time several calls on the same items in turn, round by round, so that drift of the machine hits all alike.

    Returns:
        name -> (rounds, items) [us].
    """
    names = list(calls)
    found: dict[str, list[Array]] = {name: [] for name in names}
    for name in names:  # nobody's first round pays for caches and compilers
        each_us(calls[name], items[: min(len(items), 50)])
    for r in range(rounds):
        for name in names[r % len(names) :] + names[: r % len(names)]:
            found[name].append(each_us(calls[name], items))
    return {name: np.array(times) for name, times in found.items()}


def percentiles(times: Array, prefix: str) -> dict[str, float]:
    """{prefix_p50_us, prefix_p99_us, ...} of the finite times; empty where there is none."""
    times = times[np.isfinite(times)]
    if times.size == 0:
        return {}
    return {
        f"{prefix}_{name.replace('.', '_')}_us": float(np.percentile(times, q))
        for name, q in PERCENTILES.items()
    }
