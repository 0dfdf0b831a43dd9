"""The clock: what it counts, in which order, what it makes of it, and when it is not to be trusted."""

import gc
import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from moc_opt.figures.notation import Doubtful
from moc_opt.inputs.files import to_json
from moc_opt.study import Job, run, timing
from moc_opt.study.timing import UNDISTURBED, Disturbance, Timed, each_us, interleaved, percentiles


@pytest.fixture
def spin(monkeypatch):
    """Work of so many microseconds, by a clock that only work moves."""
    now = [0]

    def work(us):
        now[0] += us * 1000

    monkeypatch.setattr(timing, "perf_counter_ns", lambda: now[0])
    return work


def test_every_call_is_timed_without_its_preparation(spin):
    results, prepared = [], []

    def prepare(item):
        prepared.append(item)
        spin(3000)

    assert each_us(spin, [50, 500, 70], results, prepare).tolist() == [50.0, 500.0, 70.0]
    assert (prepared, results) == ([50, 500, 70], [None] * 3)
    assert each_us(spin, []).shape == (0,)


def test_the_collector_is_off_while_the_clock_runs():
    during = []
    each_us(lambda item: during.append(gc.isenabled()), [1])
    assert (during, gc.isenabled()) == ([False], True)


def test_interleaved_takes_turns_chunk_by_chunk():
    log, prepared, seen = [], [], {}
    entries = {
        "a": Timed(lambda item: log.append(("a", item)), range(10), prepared.append),
        "b": Timed(lambda item: log.append(("b", item)), range(100, 112)),
    }
    times = interleaved(entries, rounds=2, chunk=5, seen=seen)
    assert {name: found.shape for name, found in times.items()} == {"a": (4, 5), "b": (4, 5)}, "every call"
    assert {name: found.calls for name, found in seen.items()} == {"a": 20, "b": 20}
    assert all(found.wall_s > 0.0 for found in seen.values())
    chunks = [log[i : i + 5] for i in range(0, len(log), 5)]
    assert all(len({name for name, _ in chunk}) == 1 for chunk in chunks)
    # A round without a clock, then two with it; who begins changes from chunk to chunk.
    assert [chunk[0][0] for chunk in chunks] == ["a", "b", "b", "a"] * 3
    assert [item for name, item in log if name == "a"] == prepared == [*range(10)] * 3
    assert [item for name, item in log if name == "b"] == [*range(100, 110)] * 3
    assert timing.ratios(np.full((2, 5), 4.0), np.full((2, 5), 1.0)).tolist() == [4.0, 4.0]
    with pytest.raises(ValueError, match="give 1 <= chunk <= items"):
        interleaved(entries, chunk=11)


def test_no_call_is_left_out_of_the_figures():
    times = np.full((10, 100), 2.0)
    times[:, :5] = 9.0  # cold, one in twenty
    times[3, 50] = 70.0
    found = timing.figures(times, "tick", UNDISTURBED)
    assert (found["tick_p50_us"], found["tick_cold_p50_us"], found["tick_max_us"]) == (2.0, 9.0, 70.0)
    assert found["tick_p99_us"] == 9.0, "without the cold ones it would be 2"
    found = percentiles(np.array([np.nan, *np.arange(1001.0)]), "solve")
    assert found == pytest.approx({"solve_p50_us": 500.0, "solve_p99_us": 990.0, "solve_p99_9_us": 999.0})
    assert percentiles(np.array([np.nan]), "solve") == {}
    assert timing.clock_cost_us() > 0.0


@pytest.mark.parametrize(
    ("seen", "trusted"),
    [
        (Disturbance(), {50.0, 99.0, 99.9, 100.0}),
        (Disturbance(4000, 0, 0, 1.0, 1.0), {50.0, 99.0, 99.9, 100.0}),
        (Disturbance(4000, 1, 0, 1.0, 1.0), {50.0, 99.0, 99.9}),
        (Disturbance(4000, 10, 0, 1.0, 1.0), {50.0, 99.0}),
        (Disturbance(4000, 11, 0, 1.0, 1.0), {50.0}),
        (Disturbance(4000, 500, 0, 0.91, 1.0), {50.0}),
        (Disturbance(4000, 501, 0, 0.91, 1.0), set()),
        (Disturbance(4000, 0, 0, 0.89, 1.0), set()),
        (Disturbance(4000, 0, 4000, 0.3, 1.0), {50.0, 99.0, 99.9, 100.0}),  # it waits for a child
        (Disturbance(4000, 40, 4000, 0.3, 1.0), {50.0}),
    ],
)
def test_a_percentile_is_trusted_where_few_calls_beyond_it_lost_the_core(seen, trusted):
    assert {q for q in (50.0, 99.0, 99.9, 100.0) if seen.trusts(q)} == trusted
    found = percentiles(np.arange(1000.0), "tick", seen)
    assert isinstance(found["tick_p99_us"], Doubtful) == (99.0 not in trusted)
    assert found == percentiles(np.arange(1000.0), "tick")


def spin_ms(ms):
    end = time.process_time() + 1e-3 * ms
    while time.process_time() < end:
        pass


def beside_a_competitor(calls):
    """Time calls of a millisecond on one core, beside a process that wants the same core all the time."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    rival = subprocess.Popen([sys.executable, "-c", "while True: pass"])  # it inherits the core
    try:
        seen = []
        times = each_us(spin_ms, [1.0] * calls, seen=seen)
        return times, seen[0]
    finally:
        rival.kill()
        rival.wait()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system holds no process to a core")
def test_times_beside_a_busy_process_on_the_same_core_are_not_trusted():
    ((times, seen),) = run([Job(beside_a_competitor, (300,))], workers=1)
    assert seen.calls == len(times) == 300
    assert seen.cpu_share < 0.8
    assert seen.switches > 10
    assert isinstance(percentiles(times, "solve", seen)["solve_p99_us"], Doubtful)


def test_the_load_is_said_with_what_it_spoilt():
    quiet = {**Disturbance(1000, 3, 0, 0.998, 1.0).entries(), "solve_p50_us": 1.0, "solve_p99_us_worst_set": 2.0}
    said = timing.load([quiet, {"solves": 3}])
    assert all(words in said for words in ("99.8 %", "3 involuntary", "all are trusted"))
    spoilt = {**Disturbance(1000, 300, 0, 0.998, 1.0).entries(), "solve_p50_us": 1.0, "solve_p99_us": Doubtful(2.0)}
    assert "1 of 2 p99 are not to be trusted" in timing.load([quiet, spoilt])
    assert timing.load([{"solves": 3}]) == ""


def test_doubts_survive_a_file_and_what_is_made_of_them():
    summary = {"part": {"a": {"p50": 1.0, "p99": Doubtful(2.0)}, "b": {"p50": 3.0}}, "note": "text"}
    kept = json.loads(to_json(timing.with_doubts(summary)))
    assert kept["part"]["a"]["p99"] == 2.0
    assert kept["part"]["a"][timing.DOUBTFUL] == ["p99"]
    assert timing.DOUBTFUL not in kept["part"]["b"]
    assert f"{Doubtful(8123.4):.1f} us" == "?8123.4 us"
