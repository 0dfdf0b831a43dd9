"""Real time, and the scheduling that a process requests from the system to keep it."""

from __future__ import annotations

import ctypes
import os
from time import monotonic, sleep

_LOCK_ALL = 1 | 2  # MCL_CURRENT | MCL_FUTURE
_SET_TIMER_SLACK = 29  # PR_SET_TIMERSLACK
PRIORITY = 50  #: Of SCHED_FIFO: above ordinary processes, below the threads in which a kernel serves interrupts.


class WallClock:
    """Periods that begin at fixed times; a tick that begins more than a period late moves all that follow.

    ``late_us`` is how late the last tick began [us], ``overruns`` how often the times were moved.
    """

    def __init__(self, period_s: float) -> None:
        self._period, self._begin = period_s, 0.0
        self.late_us, self.overruns = 0.0, 0

    def wait_for(self, tick: int) -> float:
        """Sleep until a tick begins (tick 0 a period from now); return by when its command is due (monotonic) [s]."""
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
        return now + self._period  # whoever is late, the controller has a whole period


def ask_for_realtime() -> dict[str, str]:
    """Ask for a real-time priority, for memory that is never paged out, and for exact timers; say what was granted."""
    found, libc = {"scheduling": f"SCHED_FIFO {PRIORITY}"}, ctypes.CDLL(None, use_errno=True)
    try:
        # Reset in children: the process of a solver that is replaced starts at leisure, not before the loop.
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except OSError as error:
        found["scheduling"] = f"as other processes (SCHED_FIFO: {error.strerror})"
    locked = libc.mlockall(_LOCK_ALL) == 0
    found["memory"] = "locked" if locked else f"not locked ({os.strerror(ctypes.get_errno())})"
    found["timers"] = "slack 1 ns" if libc.prctl(_SET_TIMER_SLACK, 1, 0, 0, 0) == 0 else "as they are"
    return found


def give_back_realtime() -> None:
    """Make this an ordinary process again, since the work after a run is long and not urgent."""
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        ctypes.CDLL(None).munlockall()
