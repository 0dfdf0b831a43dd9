"""Coloured tables and a progress bar for a terminal. A file or pipe gets plain text and occasional progress lines."""

from __future__ import annotations

import os
import sys
from datetime import timedelta
from typing import IO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from moc_opt.figures.notation import printable

LINE_EVERY_S = 10.0
PIPED_WIDTH = 80
CLOSED = 141
"""Exit status if the reader closes the output early, as `| head` does: the status of a command ended by SIGPIPE."""


def end_output() -> int:
    """Discard the rest of the output after the reader has closed it; return the exit status."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return CLOSED


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise SystemExit(end_output())  # rich would exit with 1, which means a defect


def console(*, stderr: bool = False, file: IO[str] | None = None) -> Console:
    """Make a console. Without a terminal, it writes plain text of 80 columns, or of the width in $COLUMNS."""
    made = _Console(stderr=stderr, file=file, highlight=False, soft_wrap=False)
    if not made.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        made.width = PIPED_WIDTH  # rich would take the width of another stream's terminal
    return made


class Bar(Progress):
    """A progress bar on stderr that vanishes at the end. Without a terminal, it is a line of text every ten seconds."""

    def __init__(
        self, description: str, total: float | None = None, *, now: str = "", on: Console | None = None
    ) -> None:
        """Make the bar for ``total`` steps (None if not known yet). ``on`` is a console to use instead of stderr."""
        where = on or console(stderr=True)
        super().__init__(
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
            TextColumn("{task.fields[now]}", style="dim", markup=False), console=where, transient=True,
            refresh_per_second=4.0, disable=not where.is_terminal,
        )  # fmt: skip
        self.add_task(printable(description), total=total, now=now, written=self.get_time())

    def step(self, now: str = "", steps: float = 1.0) -> None:
        """Count ``steps`` more steps as done, and show ``now``, the name of the current step."""
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
        """Set the number of steps once it is known, and restart the estimate of the time left."""
        self.reset(self.task_ids[0], total=total)


def busy() -> str:
    """Return a warning for measured times if the load exceeds the number of cores, else an empty text."""
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]  # the load of the last minute
    if load <= cores:
        return ""
    return f"The machine was busy (load {load:.1f} on {cores} cores): times are longer than on an idle one."
