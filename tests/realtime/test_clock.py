"""The clock against a clock of the test: no test waits for the wall's."""

from __future__ import annotations

import os
from unittest.mock import Mock

import pytest

from moc_opt.realtime import clock
from moc_opt.realtime.clock import WallClock, ask_for_realtime

T = 0.002


@pytest.fixture
def wall(monkeypatch):
    """What the time is, and how much later than asked a sleep ends."""
    now = {"s": 100.0, "oversleep": 0.0}

    def sleep(seconds):
        assert seconds > 0.0
        now["s"] += seconds + now["oversleep"]

    monkeypatch.setattr(clock, "monotonic", lambda: now["s"])
    monkeypatch.setattr(clock, "sleep", sleep)
    return now


def test_ticks_begin_at_fixed_times_whatever_they_take(wall):
    time = WallClock(T)
    for tick in range(50):
        until = time.wait_for(tick)
        assert wall["s"] == pytest.approx(100.0 + (1 + tick) * T)
        assert until == pytest.approx(wall["s"] + T)
        wall["s"] += T * (0.1 + 0.8 * (tick % 2))
    assert time.overruns == 0


def test_a_late_tick_moves_no_other_and_a_stall_all_that_follow(wall):
    time = WallClock(T)
    wall["oversleep"] = 0.5 * T
    assert time.wait_for(0) == pytest.approx(100.0 + 2.5 * T)  # the controller has its whole period
    assert time.late_us == pytest.approx(1e6 * 0.5 * T)
    wall["oversleep"] = 0.0
    time.wait_for(1)
    assert wall["s"] == pytest.approx(100.0 + 2 * T)
    assert time.overruns == 0
    wall["s"] += 10 * T
    time.wait_for(2)
    assert (time.overruns, time.late_us) == (1, pytest.approx(1e6 * 9 * T))
    begin = wall["s"]
    time.wait_for(3)
    assert wall["s"] == pytest.approx(begin + T)
    assert time.overruns == 1


def test_what_this_process_starts_later_has_no_priority(monkeypatch):
    """As the process of a solver that is replaced in a run: it starts at leisure."""
    asked, now = [], [0]

    def take(pid, policy, parameter):
        asked.append(policy)
        now[0] = policy

    monkeypatch.setattr(clock.os, "sched_setscheduler", take)
    monkeypatch.setattr(clock.os, "sched_getscheduler", lambda pid: now[0])
    monkeypatch.setattr(clock.ctypes, "CDLL", lambda *a, **k: Mock())
    ask_for_realtime()
    clock.give_back_realtime()
    assert asked == [os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.SCHED_OTHER]
