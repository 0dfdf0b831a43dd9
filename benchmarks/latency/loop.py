"""The closed loop: how many times real time it runs, in one process and in two, and what memory it takes."""

from __future__ import annotations

import resource
import sys
import tracemalloc
from collections.abc import Callable, Mapping
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks.common.crew import Crew
from benchmarks.common.processes import Worker
from benchmarks.common.timing import percentiles
from moc_opt.scenario import Scenario, Setup
from moc_opt.trace.trace import Trace


def bare(scenario: Scenario) -> Scenario:
    """Return the same run without what comes after it: no judging of answers, no scan of the largest mu."""
    return scenario.change(judge=False, bound_samples=0)


def run(scenario: Scenario) -> tuple[float, float, Trace]:
    """Time one run: wall and processor time [s], references and trace included, and the trace; building is set-up."""
    setup = Setup(scenario)
    begin, busy = perf_counter(), process_time()
    trace = setup.trace()
    return perf_counter() - begin, process_time() - busy, trace


def factors(
    scenarios: Mapping[str, Scenario], runs: int, advance: Callable[[str], None],
    beside: Callable[[], None] | None = None,
) -> tuple[dict[str, dict[str, float]], list[dict[str, Any]]]:  # fmt: skip
    """Map name to its metrics, and a row per run; every scenario once a round, one round after the other.

    ``factor`` is by the clock on the wall; ``factor_cpu`` by the time that this process had a processor, which
    other people's work on the machine lengthens less.

    Args:
        scenarios: name -> what is run.
        runs: rounds that count; one more comes first, for compilers and caches.
        advance: called after each run.
        beside: called once in each round that counts: what is timed side by side with the loops.
    """
    walls: dict[str, list[float]] = {name: [] for name in scenarios}
    busy: dict[str, list[float]] = {name: [] for name in scenarios}
    ticks: dict[str, list[Any]] = {name: [] for name in scenarios}
    rows = []
    for turn in range(1 + runs):
        for name, scenario in scenarios.items():
            wall, cpu, trace = run(scenario)
            advance(f"loop {name}")
            if turn == 0:
                continue
            simulated = len(trace) * scenario.plant.period_s
            walls[name].append(wall / simulated)
            busy[name].append(cpu / simulated)
            ticks[name].append(trace.tick_us)
            factor, factor_cpu = simulated / wall, simulated / cpu
            rows.append({
                "part": "loop", "name": name, "round": turn, "factor": factor, "factor_cpu": factor_cpu,
                "wall_s": wall, "us_per_tick": 1e6 * wall / len(trace),
            })  # fmt: skip
        if turn and beside is not None:
            beside()
    found = {
        name: {
            "factor": 1.0 / float(np.median(walls[name])),
            "factor_best": 1.0 / min(walls[name]),
            "factor_cpu": 1.0 / float(np.median(busy[name])),
            "us_per_tick": 1e6 * float(np.median(walls[name])) * scenario.plant.period_s,
            **percentiles(np.concatenate(ticks[name]), "tick"),
        }
        for name, scenario in scenarios.items()
    }
    return found, rows


def _warm(scenario: Scenario) -> None:
    run(scenario.change(duration_s=0.05))


def _work(scenario: Scenario, runs: int) -> float:
    for _ in range(runs):
        run(scenario)
    return perf_counter()


def two_processes(scenario: Scenario, runs: int, rounds: int, advance: Callable[[str], None]) -> dict[str, float]:
    """Return the throughput of two processes over that of one, both on the same number of runs a process.

    The processes are spawned, warmed up, and then used for both; rounds with one and with two alternate.
    """
    alone: list[float] = []
    together: list[float] = []
    with Crew(2, fresh=True) as crew:
        for warmed in [crew.submit(Worker.call, _warm, scenario) for _ in range(2)]:
            warmed.result()
        for _ in range(rounds):
            for wall, count in ((alone, 1), (together, 2)):
                begin = perf_counter()
                jobs = [crew.submit(Worker.call, _work, scenario, runs) for _ in range(count)]
                for one in jobs:
                    one.result()
                wall.append(perf_counter() - begin)
                advance(f"{count} process{'es' * (count - 1)}")
    gains = [2.0 * one / two for one, two in zip(alone, together, strict=True)]
    return {
        "speed_up": float(np.median(gains)), "speed_up_best": max(gains),
        "one_s": float(np.median(alone)), "two_s": float(np.median(together)),
    }  # fmt: skip


def memory(scenario: Scenario, short_s: float, long_s: float) -> dict[str, float]:
    """Return what a run takes beyond its trace, at two lengths.

    ``growth_bytes_per_tick`` is what Python's allocator handed out between the first and the last tenth of the long
    run: the trace's columns are there before the first tick, so a loop that keeps nothing has none. ``kept_*_kB`` is
    what is still held after a run, less its trace; ``resident_growth_kB`` is what the process has grown by over four
    more runs whose traces are gone.
    """
    long = scenario.change(duration_s=long_s, task={"hold_s": long_s})
    short = scenario.change(duration_s=short_s, task={"hold_s": long_s})
    run(short)
    kept = {}
    found: dict[str, float] = {}
    tracemalloc.start()
    try:
        for name, case in (("short", short), ("long", long)):
            setup = Setup(case)
            marks: dict[str, int] = {}
            ticks = len(setup.times())
            at = {ticks // 10: "early", 9 * ticks // 10: "late"}

            def watch(k: int, at: dict[int, str] = at, marks: dict[str, int] = marks) -> None:
                if k in at:
                    marks[at[k]] = tracemalloc.get_traced_memory()[0]

            before = tracemalloc.get_traced_memory()[0]
            trace = setup.trace(watch)
            held = tracemalloc.get_traced_memory()[0] - before
            kept[name] = held - sum(column.nbytes for column in trace.columns.values())
            found["growth_bytes_per_tick"] = (marks["late"] - marks["early"]) / max(1, 9 * ticks // 10 - ticks // 10)
            found["trace_bytes_per_tick"] = sum(column.nbytes for column in trace.columns.values()) / ticks
            del trace, setup
    finally:
        tracemalloc.stop()
    run(long)
    resident = _resident_kB()
    for _ in range(4):
        run(long)
    return {
        **found, "kept_short_kB": kept["short"] / 1e3, "kept_long_kB": kept["long"] / 1e3,
        "resident_growth_kB": _resident_kB() - resident,
    }  # fmt: skip


def _resident_kB() -> float:
    """Return the largest resident set of this process so far [kB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e3 if sys.platform == "darwin" else float(peak)
