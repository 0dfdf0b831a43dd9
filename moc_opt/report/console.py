"""Coloured tables and a progress bar for a terminal."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import ExitStack, redirect_stdout
from datetime import timedelta
from typing import IO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from moc_opt.figures.notation import printable
from moc_opt.inputs.files import to_json

LINE_EVERY_S = 10.0
PIPED_WIDTH = 80
CLOSED = 141
"""Exit status, as after SIGPIPE, if the reader of the output (such as `head`) ends early."""

_diverted = ExitStack()


def divert_output(wanted: bool) -> ExitStack:
    """If ``wanted``, send stdout to stderr, until `print_json` is called or the returned context ends.

    This includes the output of C code and new processes.
    """
    if wanted and sys.stdout is not None and sys.stderr is not None:
        sys.stdout.flush()
        kept = os.dup(1)
        os.dup2(2, 1)
        for undo in ((os.close, kept), (os.dup2, kept, 1), (ctypes.CDLL(None).fflush, None)):  # run in reverse order
            _diverted.callback(*undo)
        _diverted.enter_context(redirect_stdout(sys.stderr))
    return _diverted


def print_json(value: object, *, sort_keys: bool = False) -> None:
    """Print a result as JSON to stdout, and end `divert_output`."""
    _diverted.close()
    print(to_json(value, sort_keys=sort_keys))


def end_output() -> int:
    """Discard the rest of the output; return `CLOSED`."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return CLOSED


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise SystemExit(end_output())  # rich would exit with 1


def console(*, stderr: bool = False, file: IO[str] | None = None) -> Console:
    """Make a console. Without a terminal, it writes 80 columns of plain text."""
    made = _Console(stderr=stderr, file=file, highlight=False, soft_wrap=False)
    if not made.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        made.width = PIPED_WIDTH  # rich would take the width of the terminal at stdin or stderr
    return made


class Bar(Progress):
    """A progress bar on stderr. Without a terminal, it prints a line at most every `LINE_EVERY_S`."""

    def __init__(
        self, description: str, total: float | None = None, *, now: str = "", on: Console | None = None
    ) -> None:
        """Make the bar for ``total`` steps (None: not known yet)."""
        where = on or console(stderr=True)
        super().__init__(
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
            TextColumn("{task.fields[now]}", style="dim", markup=False), console=where, transient=True,
            refresh_per_second=4.0, disable=not where.is_terminal,
        )  # fmt: skip
        self.add_task(printable(description), total=total, now=now, written=self.get_time())

    def step(self, now: str = "", steps: float = 1.0) -> None:
        """Count ``steps`` as done, and show ``now``, the name of the current step."""
        (task,) = self.tasks
        self.update(task.id, advance=steps, now=printable(now))
        if self.console.is_terminal or self.get_time() - task.fields["written"] < LINE_EVERY_S:
            return
        self.update(task.id, written=self.get_time())
        line = task.description
        if task.elapsed and task.total and task.completed:
            share = min(task.completed / task.total, 1.0)
            left = timedelta(seconds=round(task.elapsed * (1.0 / share - 1.0)))
            line += f": {100.0 * share:.0f} % after {timedelta(seconds=round(task.elapsed))}, about {left} left"
        self.console.print(f"{line}  {task.fields['now']}".rstrip(), markup=False, soft_wrap=True)

    def of(self, total: float) -> None:
        """Set the total number of steps, and count from 0 again."""
        self.reset(self.task_ids[0], total=total)


def busy() -> str:
    """Return a warning if the machine is busy, else an empty text."""
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    if load <= cores:
        return ""
    return f"The machine was busy (load {load:.1f} on {cores} cores): times are longer than on an idle machine."
