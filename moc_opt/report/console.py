"""The terminal: tables in colour, a progress bar for long work, a line now and then if the output is no terminal."""

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
"""Exit status if the reader of the output has closed it, as `| head` does: that of a command ended by SIGPIPE."""


def end_output() -> int:
    """Send what is still buffered for stdout nowhere, since nobody reads it any more; return the exit status."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return CLOSED


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise SystemExit(end_output())  # rich's own status is 1, that of a defect


def console(*, stderr: bool = False, file: IO[str] | None = None) -> Console:
    """Make a console; where its output is no terminal it writes plain text, 80 columns wide or as many as COLUMNS says.

    Results belong on stdout, messages on stderr.
    """
    made = _Console(stderr=stderr, file=file, highlight=False, soft_wrap=False)
    if not made.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        made.width = PIPED_WIDTH  # and not that of the terminal which may lie behind another stream
    return made


class Bar(Progress):
    """A bar with the time left on stderr, until the work is done; without a terminal, a line every ten seconds."""

    def __init__(
        self, description: str, total: float | None = None, *, now: str = "", on: Console | None = None
    ) -> None:
        """Begin; ``total`` is None where the number of steps is not known yet, ``on`` another console."""
        where = on or console(stderr=True)
        super().__init__(
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
            TextColumn("{task.fields[now]}", style="dim", markup=False), console=where, transient=True,
            refresh_per_second=4.0, disable=not where.is_terminal,
        )  # fmt: skip
        self.add_task(printable(description), total=total, now=now, written=self.get_time())

    def step(self, now: str = "", steps: float = 1.0) -> None:
        """Count so many more steps as done, and name what is being done now."""
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
        """Say how many steps there are, once that is known: the time that is left counts from now."""
        self.reset(self.task_ids[0], total=total)


def busy() -> str:
    """Return a sentence where more threads want to run than there are cores, to stand beside times; else empty."""
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]  # the load of the last minute
    if load <= cores:
        return ""
    return f"The machine was busy (load {load:.1f} on {cores} cores): times are longer than on an idle one."
