"""The clock of every benchmark: what is timed, how, and which figures are quoted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from time import perf_counter_ns
from typing import Any, NamedTuple

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.sim.loop import no_collector

COLD = 5  # calls after another entry's turn that find its data in the caches
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}


def clock_cost_us(samples: int = 2000) -> float:
    """Return what reading the clock twice costs [us]; it is left inside every figure and reported beside them."""
    gaps = np.empty(samples)
    for i in range(samples):
        begin = perf_counter_ns()
        gaps[i] = perf_counter_ns() - begin
    return float(np.median(gaps) * 1e-3)


def each_us(
    call: Callable[[Any], Any], items: Iterable[Any], results: list[Any] | None = None,
    prepare: Callable[[Any], Any] | None = None,
) -> Array:  # fmt: skip
    """Time ``call(item)`` one by one [us], without garbage-collection pauses.

    Args:
        prepare: called with each item before the clock starts.
    """
    times = []
    keep = results.append if results is not None else None
    with no_collector():
        for item in items:
            if prepare is not None:
                prepare(item)
            begin = perf_counter_ns()
            result = call(item)
            times.append(perf_counter_ns() - begin)
            if keep is not None:
                keep(result)
    return np.array(times) * 1e-3


class Timed(NamedTuple):
    """One entry of `interleaved`: what is called, on which items, after which preparation."""

    call: Callable[[Any], Any]
    items: Sequence[Any]
    prepare: Callable[[Any], Any] | None = None


def interleaved(entries: Mapping[str, Timed], rounds: int = 3, chunk: int = 100) -> dict[str, Array]:
    """Time several calls side by side: each goes through its own items, ``chunk`` of them at a time, in turn.

    Whatever the machine does meanwhile hits all alike, so ratios of what is found chunk by chunk are steadier than
    the times. All entries have as many items as the shortest.

    Args:
        entries: name -> what is timed.
        rounds: how often all items are gone through; one round more comes first and is not timed.
        chunk: items in a row. Every one counts, also the first ones, which find other entries' data in the caches.

    Returns:
        name -> (rounds * chunks, chunk) [us].

    Raises:
        ValueError: fewer items than a chunk.
    """
    length = min(len(entry.items) for entry in entries.values())
    if not 1 <= chunk <= length:
        raise ValueError(f"chunk = {chunk} with {length} items: give 1 <= chunk <= items")
    names = list(entries)
    found: dict[str, list[Array]] = {name: [] for name in names}
    starts = range(0, length - chunk + 1, chunk)
    for turn in range((1 + rounds) * len(starts)):
        begin = starts[turn % len(starts)]
        first = turn % len(names)
        for name in names[first:] + names[:first]:
            entry = entries[name]
            times = each_us(entry.call, entry.items[begin : begin + chunk], prepare=entry.prepare)
            if turn >= len(starts):
                found[name].append(times)
    return {name: np.array(times) for name, times in found.items()}


def ratios(times: Array, base: Array) -> Array:
    """Return the ratio of the medians, chunk by chunk (chunks,), of two results of `interleaved`."""
    found: Array = np.median(times, axis=1) / np.median(base, axis=1)
    return found


def figures(times: Array, prefix: str) -> dict[str, float]:
    """Return percentiles and maximum of a result of `interleaved` (chunks, chunk), and the median of the cold calls.

    The cold calls are the first ``COLD`` of each chunk: another entry ran before them.
    """
    cold = float(np.median(times[:, :COLD]))
    return {
        **percentiles(times.ravel(), prefix), f"{prefix}_max_us": float(times.max()), f"{prefix}_cold_p50_us": cold
    }  # fmt: skip


def percentiles(times: Array, prefix: str) -> dict[str, float]:
    """Return {prefix_p50_us, prefix_p99_us, ...} of the finite times; empty where there is none."""
    times = times[np.isfinite(times)]
    if times.size == 0:
        return {}
    return {f"{prefix}_{name.replace('.', '_')}_us": float(np.percentile(times, q)) for name, q in PERCENTILES.items()}
