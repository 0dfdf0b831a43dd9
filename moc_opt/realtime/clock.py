"""A clock for control periods, and requests for real-time scheduling."""

from __future__ import annotations

import ctypes
import os
from time import monotonic, sleep

_LOCK_ALL = 1 | 2  # MCL_CURRENT | MCL_FUTURE
_SET_TIMER_SLACK = 29  # PR_SET_TIMERSLACK
PRIORITY = 50  #: Priority under SCHED_FIFO.


class WallClock:
    """A clock for periods that begin at fixed times. A tick that is more than a period late delays all later ticks.

    ``late_us`` is the last tick's delay [us]; ``overruns`` counts the ticks that were more than a period late.
    """

    def __init__(self, period_s: float) -> None:
        self._period, self._begin = period_s, 0.0
        self.late_us, self.overruns = 0.0, 0

    def wait_for(self, tick: int) -> float:
        """Sleep until a tick begins, and return its deadline (`monotonic`) [s]."""
        if tick == 0:
            self._begin = monotonic() + self._period
        due = self._begin + tick * self._period
        left = due - monotonic()
        if left > 0.0:
            sleep(left)
        now = monotonic()
        self.late_us = 1e6 * (now - due)
        if now - due > self._period:
            self._begin += now - due
            self.overruns += 1
        return now + self._period  # a whole period, even if the tick began late


def ask_for_realtime() -> dict[str, str]:
    """Request real-time priority, locked memory and exact timers. Return what was granted."""
    found, libc = {"scheduling": f"SCHED_FIFO {PRIORITY}"}, ctypes.CDLL(None, use_errno=True)
    try:
        # RESET_ON_FORK: a new solver process has ordinary priority, and does not slow the loop down.
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except OSError as error:
        found["scheduling"] = f"as other processes (SCHED_FIFO: {error.strerror})"
    locked = libc.mlockall(_LOCK_ALL) == 0
    found["memory"] = "locked" if locked else f"not locked ({os.strerror(ctypes.get_errno())})"
    found["timers"] = "slack 1 ns" if libc.prctl(_SET_TIMER_SLACK, 1, 0, 0, 0) == 0 else "as they are"
    return found


def give_back_realtime() -> None:
    """Return to ordinary scheduling."""
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        ctypes.CDLL(None).munlockall()
