"""Measured times."""

import gc
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from moc_opt.study import Job, run, timing
from moc_opt.study.timing import COUNTED, each_us, percentiles


def test_calls_are_timed_without_garbage_collection(monkeypatch):
    now, results, during, seen = [0], [], [], []

    def work(us):
        now[0] += us * 1000
        during.append(gc.isenabled())
        return us

    monkeypatch.setattr(timing, "perf_counter_ns", lambda: now[0])
    assert each_us(work, [50, 500, 70], results, seen).tolist() == [50.0, 500.0, 70.0]
    assert (results, during, gc.isenabled()) == ([50, 500, 70], [False] * 3, True)
    assert [found["times_calls"] for found in seen] == [3]
    assert each_us(work, []).shape == (0,)


def test_percentiles_ignore_non_finite_times():
    found = percentiles(np.array([np.nan, *np.arange(1001.0)]), "solve")
    assert found == pytest.approx({"solve_p50_us": 500.0, "solve_p99_us": 990.0, "solve_p99_9_us": 999.0})
    assert percentiles(np.array([np.nan]), "solve") == {}
    assert timing.clock_cost_us() > 0.0


@pytest.mark.parametrize(
    ("seen", "quiet"),
    [((), True), ((4000, 10, 1.0, 1.0), True), ((4000, 11, 1.0, 1.0), False), ((4000, 0, 0.9, 1.0), True),
     ((4000, 0, 0.89, 1.0), False)],
)  # fmt: skip
def test_machine_is_quiet_if_other_processes_seldom_interrupt_calls(seen, quiet):
    row = dict(zip(COUNTED, seen, strict=False))
    assert timing.quiet(row) is quiet
    said = timing.load([{"solves": 3}, row, dict(zip(COUNTED, (1000, 2, 0.998, 1.0), strict=True))])
    assert ("the machine was quiet." if quiet else " 1 of ") in said
    assert timing.load([{"solves": 3}]) == ""


def spin_ms(ms):
    end = time.process_time() + 1e-3 * ms
    while time.process_time() < end:
        pass


def beside_a_competitor(calls):
    """Time calls on a core that another process also uses."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    rival = subprocess.Popen([sys.executable, "-c", "while True: pass"])  # the new process inherits the affinity
    try:
        seen = []
        each_us(spin_ms, [1.0] * calls, seen=seen)
        return seen[0]
    finally:
        rival.kill()
        rival.wait()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system cannot bind a process to a core")
def test_times_on_a_shared_core_are_not_trusted():
    (seen,) = run([Job(beside_a_competitor, (300,))], workers=1)
    assert (seen["times_calls"], timing.quiet(seen)) == (300, False)
    assert timing.cpu_share(seen) < 0.8
    assert seen["times_switches"] > 10
