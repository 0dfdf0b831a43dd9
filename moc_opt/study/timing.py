"""The clock of every benchmark: the timed calls, what the machine did meanwhile, and the figures that are quoted."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, astuple, dataclass
from time import perf_counter, perf_counter_ns, process_time
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.sim.loop import no_collector

PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
MOST_SWITCHES = 0.0025  # of the calls: a quarter of those beyond the 99th percentile
LEAST_CPU_SHARE = 0.9


@dataclass(frozen=True)
class Disturbance:
    """What the machine did to this process while calls were timed; those of several stretches add up.

    It does not show what lengthens every call alike: caches, memory or half a core shared with others, a lower clock.
    """

    calls: int = 0  #: that were timed
    switches: int = 0  #: how often the core was taken from the process (ru_nivcsw)
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
        """Return {times_calls, times_switches, times_cpu_s, times_wall_s}."""
        return {f"times_{name}": value for name, value in asdict(self).items()}

    def __add__(self, other: Disturbance) -> Disturbance:
        return Disturbance(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __sub__(self, other: Disturbance) -> Disturbance:
        return Disturbance(*(a - b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def cpu_share(self) -> float:
        """Processor time over time by the clock; above 1 with threads of its own."""
        return self.cpu_s / self.wall_s if self.wall_s else 1.0

    @property
    def quiet(self) -> bool:
        """Whether the 99th percentile of the times is to be trusted (docs/solvers.md has what that was measured on).

        A switch lengthens one call. Where a hypervisor takes the core, the process has less of it without a switch.
        """
        return self.switches <= MOST_SWITCHES * self.calls and self.cpu_share >= LEAST_CPU_SHARE


def used() -> Disturbance:
    """Return what this process has used since it began; the difference of two is what happened between them."""
    return Disturbance(0, resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw, process_time(), perf_counter())


def load(rows: Iterable[Mapping[str, Any]]) -> str:
    """Say what the machine did while the times in these rows were taken; "" where there are none."""
    timed = [seen for seen in map(Disturbance.of, rows) if seen.calls]
    if not timed:
        return ""
    total, spoilt = sum(timed, Disturbance()), sum(not seen.quiet for seen in timed)
    said = (
        f"Times were taken with {100.0 * total.cpu_share:.1f} % of a core and {total.switches:,} involuntary context "
        f"switches in {total.wall_s:.1f} s: "
    )
    if not spoilt:
        return said + "the machine was quiet."
    return said + (
        f"others used the machine in {spoilt} of {len(timed)} measurements, whose p99 is not to be trusted. Run again "
        "on a quiet machine: the same command measures these anew."
    )


def clock_cost_us() -> float:
    """Return what reading the clock twice costs [us]; it is left inside every figure and reported beside them."""
    gaps = np.empty(2000)
    for i in range(len(gaps)):
        begin = perf_counter_ns()
        gaps[i] = perf_counter_ns() - begin
    return float(np.median(gaps) * 1e-3)


def each_us(
    call: Callable[[Any], Any], items: Iterable[Any], results: list[Any] | None = None,
    seen: list[Disturbance] | None = None,
) -> Array:  # fmt: skip
    """Time ``call(item)`` one by one [us], without garbage-collection pauses.

    Results, and in ``seen`` what the machine did meanwhile, are appended to the lists that are given.
    """
    times, found = [], [] if results is None else results
    with no_collector():
        before = used()
        for item in items:
            begin = perf_counter_ns()
            result = call(item)
            times.append(perf_counter_ns() - begin)
            found.append(result)
        if seen is not None:
            seen.append(used() - before + Disturbance(len(times)))
    return np.array(times) * 1e-3


def percentiles(times: Array, prefix: str) -> dict[str, float]:
    """Return {prefix_p50_us, prefix_p99_us, prefix_p99_9_us} of the finite times, if any."""
    times = times[np.isfinite(times)]
    if times.size == 0:
        return {}
    return {
        f"{prefix}_{name.replace('.', '_')}_us": float(np.percentile(times, q)) for name, q in PERCENTILES.items()
    }
