"""The clock of every benchmark: the timed calls, what the machine did meanwhile, and the figures that are quoted."""

from __future__ import annotations

import re
import resource
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from time import perf_counter, perf_counter_ns, process_time
from typing import Any, NamedTuple

import numpy as np

from moc_opt.arrays import Array
from moc_opt.figures.notation import Doubtful
from moc_opt.sim.loop import no_collector

COLD = 5  # calls after another entry's turn that find its data in the caches
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
MOST_HIT = 0.25  # switches, over the calls beyond a percentile
LEAST_CPU_SHARE = 0.9
OWN_WAITS = 0.01  # voluntary switches per call, from where on a process waits of its own accord
DOUBTFUL = "doubtful"  # in a row of summary.json: the names of its figures that are not to be trusted


@dataclass(frozen=True)
class Disturbance:
    """What the machine did to this process while calls were timed; those of several stretches add up.

    It does not show what lengthens every call alike: caches, memory or half a core shared with others, a lower clock.
    """

    calls: int = 0  #: that were timed
    switches: int = 0  #: how often the core was taken from the process (ru_nivcsw)
    waits: int = 0  #: how often it gave the core away (ru_nvcsw)
    cpu_s: float = 0.0  #: that all its threads had a core [s]
    wall_s: float = 0.0  #: by the clock on the wall [s]

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Disturbance:
        """Read off a row what `entries` wrote there; zeros where it wrote nothing."""
        return cls(**{name: row[f"times_{name}"] for name in cls.__dataclass_fields__ if f"times_{name}" in row})

    @classmethod
    def total(cls, rows: Iterable[Mapping[str, Any]]) -> Disturbance:
        """Return the sum over rows."""
        return sum(map(cls.of, rows), cls())

    def entries(self) -> dict[str, float]:
        """Return {times_calls, times_switches, times_waits, times_cpu_s, times_wall_s}."""
        return {f"times_{name}": value for name, value in asdict(self).items()}

    def __add__(self, other: Disturbance) -> Disturbance:
        return Disturbance(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __sub__(self, other: Disturbance) -> Disturbance:
        return Disturbance(*(a - b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def told(self) -> dict[str, float]:
        """Return the same for environment.json, with the share of a core."""
        return asdict(self) | {"cpu_share": self.cpu_share}

    @property
    def cpu_share(self) -> float:
        """Processor time over time by the clock; above 1 with threads of its own."""
        return self.cpu_s / self.wall_s if self.wall_s else 1.0

    def trusts(self, percentile: float) -> bool:
        """Return whether a percentile of the times is to be trusted (docs/solvers.md has what that was measured on).

        A switch lengthens one call: there may be ``MOST_HIT`` as many as calls beyond the percentile. None holds where
        the process had less than ``LEAST_CPU_SHARE`` of a core, unless it waits of its own accord, for a thread or a
        child: a hypervisor takes the core, which no switch shows.
        """
        few = self.switches <= MOST_HIT * (1.0 - percentile / 100.0) * self.calls + 1e-9
        return few and (self.cpu_share >= LEAST_CPU_SHARE or self.waits > OWN_WAITS * self.calls)

    def judged(self, value: float, percentile: float) -> float:
        """Return the value of a percentile, a `Doubtful` where it is not to be trusted."""
        return value if self.trusts(percentile) else Doubtful(value)


UNDISTURBED = Disturbance()


def used() -> Disturbance:
    """Return what this process has used since it began; the difference of two is what happened between them."""
    found = resource.getrusage(resource.RUSAGE_SELF)
    return Disturbance(0, found.ru_nivcsw, found.ru_nvcsw, process_time(), perf_counter())


def clock_cost_us() -> float:
    """Return what reading the clock twice costs [us]; it is left inside every figure and reported beside them."""
    gaps = np.empty(2000)
    for i in range(len(gaps)):
        begin = perf_counter_ns()
        gaps[i] = perf_counter_ns() - begin
    return float(np.median(gaps) * 1e-3)


def each_us(
    call: Callable[[Any], Any], items: Iterable[Any], results: list[Any] | None = None,
    prepare: Callable[[Any], Any] | None = None, seen: list[Disturbance] | None = None,
) -> Array:  # fmt: skip
    """Time ``call(item)`` one by one [us], without garbage-collection pauses, each after ``prepare(item)``.

    Results, and in ``seen`` what the machine did meanwhile, are appended to the lists that are given.
    """
    times = []
    keep = results.append if results is not None else None
    with no_collector():
        before = used()
        for item in items:
            if prepare is not None:
                prepare(item)
            begin = perf_counter_ns()
            result = call(item)
            times.append(perf_counter_ns() - begin)
            if keep is not None:
                keep(result)
        if seen is not None:
            seen.append(used() - before + Disturbance(len(times)))
    return np.array(times) * 1e-3


class Timed(NamedTuple):
    """One entry of `interleaved`: the call, its items, and their preparation."""

    call: Callable[[Any], Any]
    items: Sequence[Any]
    prepare: Callable[[Any], Any] | None = None


def interleaved(
    entries: Mapping[str, Timed], rounds: int = 3, chunk: int = 100, seen: dict[str, Disturbance] | None = None
) -> dict[str, Array]:
    """Time several calls side by side: each goes through its own items, ``chunk`` of them at a time, in turn.

    Whatever the machine does meanwhile hits all alike, so ratios of what is found chunk by chunk are steadier than
    the times. All entries have as many items as the shortest. One round comes before ``rounds`` and is not timed.

    Returns:
        name -> (rounds * chunks, chunk) [us]; ``seen`` is filled with what the machine did to each entry.

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
            here: list[Disturbance] = []
            times = each_us(entry.call, entry.items[begin : begin + chunk], prepare=entry.prepare, seen=here)
            if turn >= len(starts):
                found[name].append(times)
                if seen is not None:
                    seen[name] = seen.get(name, Disturbance()) + here[0]
    return {name: np.array(times) for name, times in found.items()}


def ratios(times: Array, base: Array) -> Array:
    """Return the ratio of the medians, chunk by chunk (chunks,), of two results of `interleaved`."""
    found: Array = np.median(times, axis=1) / np.median(base, axis=1)
    return found


def figures(times: Array, prefix: str, seen: Disturbance) -> dict[str, float]:
    """Return percentiles and maximum of a result of `interleaved`, and the median of the first calls of each chunk."""
    return {
        **percentiles(times.ravel(), prefix, seen), f"{prefix}_max_us": seen.judged(float(times.max()), 100.0),
        f"{prefix}_cold_p50_us": seen.judged(float(np.median(times[:, :COLD])), 50.0), **seen.entries(),
    }  # fmt: skip


def percentiles(times: Array, prefix: str, seen: Disturbance = UNDISTURBED) -> dict[str, float]:
    """Return {prefix_p50_us, ...} of the finite times, if any; a percentile that the machine spoilt is `Doubtful`."""
    times = times[np.isfinite(times)]
    if times.size == 0:
        return {}
    return {
        f"{prefix}_{name.replace('.', '_')}_us": seen.judged(float(np.percentile(times, q)), q)
        for name, q in PERCENTILES.items()
    }


def load(rows: Sequence[Mapping[str, Any]]) -> str:
    """Say what the machine did while the times in these rows were taken, and which are not to be trusted."""
    seen = Disturbance.total(rows)
    if not seen.calls:
        return ""
    counted = []
    for name in PERCENTILES:
        time = re.compile(rf"_{name.replace('.', '_')}_us(_worst_set|_n\d+)?$")
        values = [value for row in rows for key, value in row.items() if time.search(key)]
        doubtful = sum(isinstance(value, Doubtful) for value in values)
        counted += [f"{doubtful} of {len(values)} {name}"] if doubtful else []
    said = (
        f"Times were taken with {100.0 * seen.cpu_share:.1f} % of a core and {seen.switches:,} involuntary context "
        f"switches in {seen.wall_s:.1f} s: "
    )
    if not counted:
        return said + "all are trusted."
    return said + (
        f"{', '.join(counted)} are not to be trusted. They are marked ? and decide no verdict; run again on a quiet "
        "machine."
    )


def with_doubts(value: Any) -> Any:
    """Return a summary for a file: beside its `Doubtful` figures each mapping names them under ``DOUBTFUL``."""
    if not isinstance(value, Mapping):
        return value
    names = [key for key, entry in value.items() if isinstance(entry, Doubtful)]
    return {key: with_doubts(entry) for key, entry in value.items()} | ({DOUBTFUL: names} if names else {})
