"""The interpreter that loop and solver share: save the state that foreign code may change, and restore it.

A library may change it when it is loaded or called: the rounding of the processor, numpy's error state, the handler
of Ctrl-C. Changes of environment, threads, open files, limits of resources and modules are not undone; only a
separate process protects them (``[solver] isolation = "process"``).
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import warnings
from contextlib import suppress
from time import monotonic
from typing import Self

import numpy as np

_ENVIRONMENT_BYTES = 64  # fenv_t has 32 on x86-64, 8 on arm64
_TIMERS = (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL, signal.ITIMER_PROF)


class Interpreter:
    """The interpreter's state at construction; as a context manager, restores it at the end.

    Of this thread: tracing and profiling functions, numpy's error state, the processor's rounding, traps and handling
    of the smallest numbers, blocked signals. Of the process, from the main thread alone, as others may be at work on
    it: handlers of signals, timers, the recursion limit and the switch interval, filters of warnings, standard
    streams, working directory, and the mask of new files.
    """

    def __init__(self) -> None:
        self._quick = sys.getrecursionlimit(), sys.gettrace(), sys.getprofile()
        self._errors, self._blocked = np.geterr(), signal.pthread_sigmask(signal.SIG_BLOCK, ())
        self._floats = ctypes.create_string_buffer(_ENVIRONMENT_BYTES)
        _libm.fegetenv(self._floats)
        self._has_process = _is_main_thread()
        if self._has_process:
            self._handlers = {number: signal.getsignal(number) for number in _HANDLED}
            self._begin_s = monotonic()
            self._timers = [signal.getitimer(which) for which in _TIMERS]
            self._switch_s, self._filters = sys.getswitchinterval(), list(warnings.filters)
            self._streams = {name: getattr(sys, name) for name in ("stdin", "stdout", "stderr", "excepthook")}
            self._mask, self._folder = _umask(), _folder()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Put everything back."""
        self.restore()

    def calm(self) -> None:
        """Restore what affects the next lines of code; takes a fraction of a microsecond where nothing changed."""
        depth, trace, profile = self._quick
        if sys.gettrace() is not trace or sys.getprofile() is not profile or sys.getrecursionlimit() != depth:
            sys.setprofile(profile)
            sys.settrace(trace)
            sys.setrecursionlimit(depth)

    def answer_signals(self) -> None:
        """Restore the handlers of the signals that end a run; takes some microseconds."""
        if self._has_process and _is_main_thread():
            self._handle(*_ENDING)

    def restore(self) -> None:
        """Restore everything; takes half a millisecond."""
        self.calm()
        _libm.fesetenv(self._floats)
        np.seterr(**self._errors)
        if self._has_process and _is_main_thread():
            self._restore_process()
        signal.pthread_sigmask(signal.SIG_SETMASK, self._blocked)

    def _handle(self, *numbers: int) -> None:
        for number in numbers:
            handler = self._handlers[number]
            if handler is not None:  # set even if it is unchanged in Python: a library in C may have replaced it
                signal.signal(number, handler)

    def _restore_process(self) -> None:
        passed = monotonic() - self._begin_s
        for which, (left, interval) in zip(_TIMERS, self._timers, strict=True):
            if left == 0.0:
                signal.setitimer(which, 0.0)
            elif which == signal.ITIMER_REAL and left > passed:  # a timer that is over has fired
                signal.setitimer(which, left - passed, interval)
        self._handle(*_HANDLED)
        sys.setswitchinterval(self._switch_s)
        if warnings.filters != self._filters:
            warnings.resetwarnings()  # which also tells the interpreter that they changed
            warnings.filters[:] = self._filters  # type: ignore[index]
        for name, stream in self._streams.items():
            setattr(sys, name, stream)
        os.umask(self._mask)
        with suppress(OSError):  # it may be gone
            if self._folder and _folder() != self._folder:
                os.chdir(self._folder)


def _is_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:
        return ""


_libm = ctypes.CDLL(None)
_HANDLED: tuple[int, ...] = tuple(set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP})
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
