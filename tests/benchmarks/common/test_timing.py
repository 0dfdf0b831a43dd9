"""The clock: what it counts, in which order, and what it makes of it."""

import gc

import numpy as np
import pytest

from benchmarks.common.timing import (
    Timed,
    clock_cost_us,
    each_us,
    figures,
    interleaved,
    percentiles,
    ratios,
)


@pytest.fixture
def spin(monkeypatch):
    """Work of so many microseconds, by a clock that only work moves."""
    now = [0]

    def work(us):
        now[0] += us * 1000

    monkeypatch.setattr("benchmarks.common.timing.perf_counter_ns", lambda: now[0])
    return work


def test_every_call_is_timed_and_its_result_kept(spin):
    results = []
    times = each_us(spin, [50, 500, 70], results)
    assert times.tolist() == [50.0, 500.0, 70.0]
    assert results == [None, None, None]
    assert each_us(lambda item: 2 * item, [], results).shape == (0,)


def test_preparation_is_not_counted(spin):
    prepared = []

    def prepare(item):
        prepared.append(item)
        spin(3000)

    times = each_us(spin, [1, 2, 3], prepare=prepare)
    assert prepared == [1, 2, 3]
    assert times.tolist() == [1.0, 2.0, 3.0]


def test_collector_is_off_while_the_clock_runs_and_as_before_afterwards():
    during = []
    each_us(lambda item: during.append(gc.isenabled()), [1])
    assert during == [False]
    assert gc.isenabled()
    gc.disable()
    try:
        each_us(lambda item: None, [1])
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_an_error_switches_the_collector_on_again():
    with pytest.raises(ZeroDivisionError):
        each_us(lambda item: 1 // item, [0])
    assert gc.isenabled()


def test_interleaved_takes_turns_chunk_by_chunk():
    log = []
    entries = {
        "a": Timed(lambda item: log.append(("a", item)), range(10)),
        "b": Timed(lambda item: log.append(("b", item)), range(100, 112)),
    }
    times = interleaved(entries, rounds=2, chunk=5)
    assert {name: found.shape for name, found in times.items()} == {"a": (4, 5), "b": (4, 5)}  # every call
    chunks = [log[i : i + 5] for i in range(0, len(log), 5)]
    assert all(len({name for name, _ in chunk}) == 1 for chunk in chunks)
    # A round without a clock, then two with it; who begins changes from chunk to chunk.
    assert [chunk[0][0] for chunk in chunks] == ["a", "b", "b", "a"] * 3
    assert [item for name, item in log if name == "a"] == [*range(10)] * 3
    assert [item for name, item in log if name == "b"] == [*range(100, 110)] * 3


def test_interleaved_tells_slow_from_fast(spin):
    slow = Timed(lambda item: spin(400), range(20))
    fast = Timed(lambda item: spin(100), range(20))
    times = interleaved({"slow": slow, "fast": fast}, rounds=1, chunk=10)
    found = ratios(times["slow"], times["fast"])
    assert found.tolist() == [4.0, 4.0]


@pytest.mark.parametrize("chunk", [11, 0])
def test_interleaved_refuses_chunks_that_leave_nothing(chunk):
    with pytest.raises(ValueError, match="give 1 <= chunk <= items"):
        interleaved({"a": Timed(abs, range(10))}, chunk=chunk)


def test_no_call_is_left_out_of_the_figures():
    times = np.full((10, 100), 2.0)
    times[:, :5] = 9.0  # cold, one in twenty
    times[3, 50] = 70.0
    found = figures(times, "tick")
    assert (found["tick_p50_us"], found["tick_cold_p50_us"], found["tick_max_us"]) == (2.0, 9.0, 70.0)
    assert found["tick_p99_us"] == 9.0  # without the cold ones it would be 2


def test_interleaved_prepares_each_item():
    prepared = []
    interleaved({"a": Timed(lambda item: None, range(6), prepared.append)}, rounds=1, chunk=3)
    assert prepared == [*range(6)] * 2


def test_percentiles_leave_out_what_has_no_time():
    found = percentiles(np.array([np.nan, *np.arange(1001.0)]), "solve")
    assert found == pytest.approx({"solve_p50_us": 500.0, "solve_p99_us": 990.0, "solve_p99_9_us": 999.0})
    assert percentiles(np.array([np.nan]), "solve") == {}


def test_the_clock_itself_costs_little():
    assert clock_cost_us(200) > 0.0
