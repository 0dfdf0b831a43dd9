"""The terminal: tables in colour, a progress bar for long work, no bar if the output is no terminal."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from threading import Timer
from typing import IO, Any

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from moc_opt.figures.notation import printable
from moc_opt.inputs.files import to_json

PATIENCE_S = 2.0
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

    Args:
        stderr: write there; results belong on stdout, messages on stderr.
        file: write to it instead.
    """
    made = _Console(stderr=stderr, file=file, highlight=False, soft_wrap=False)
    if not made.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        made.width = PIPED_WIDTH  # and not that of the terminal which may lie behind another stream
    return made


class Bar:
    """A progress bar: `advance` it, say what it is `at`. Without a terminal it writes a line now and then."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress, self._task = progress, task
        self._begun = self._told = time.monotonic()

    def advance(self, steps: float = 1.0) -> None:
        """Count so many more steps as done."""
        self._progress.update(self._task, advance=steps)
        if not self._progress.console.is_terminal and time.monotonic() - self._told > LINE_EVERY_S:
            self.tell()

    def tell(self) -> None:
        """Write a line: how far it is, and how long it will take at the pace so far."""
        self._told = time.monotonic()
        (task,) = self._progress.tasks
        said, spent = task.description, self._told - self._begun
        if task.total and task.completed:
            share = min(task.completed / task.total, 1.0)
            after, left = (timedelta(seconds=round(seconds)) for seconds in (spent, spent * (1.0 / share - 1.0)))
            said += f": {100.0 * share:.0f} % after {after}, about {left} left"
        line = f"{said}  {task.fields['now']}".rstrip()
        self._progress.console.print(line, markup=False, soft_wrap=True)

    def of(self, total: float) -> None:
        """Say how many steps there are, once that is known."""
        self._progress.update(self._task, total=total)

    def at(self, text: str) -> None:
        """Name what is being done now."""
        self._progress.update(self._task, now=printable(text))


class _Screen(Progress):
    """A bar, and below it what is known so far."""

    below: Callable[[], Iterable[RenderableType]] = staticmethod(tuple)

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        yield from self.below()


@contextmanager
def progress(
    description: str, total: float | None = None, *, on: Console | None = None, patience_s: float = PATIENCE_S,
    below: Callable[[], Iterable[RenderableType]] = tuple,
) -> Iterator[Bar]:  # fmt: skip
    """Show a bar with the time left on stderr, once `patience_s` is over and until the work is done.

    Where the output is not a terminal, a line every ten seconds; the first one comes before a step is done, too.

    Args:
        total: steps in all; None where that is not known.
        patience_s: seconds without a bar; work that is done by then never shows one.
        below: what is drawn below it, asked for at each refresh.
    """
    where = on or console(stderr=True)
    done = MofNCompleteColumn() if below is tuple else TaskProgressColumn()  # with a table below, steps are weighted
    bar = _Screen(
        TextColumn("{task.description}", markup=False), BarColumn(), done, TimeRemainingColumn(),
        TextColumn("{task.fields[now]}", style="dim", markup=False), console=where, transient=True,
        refresh_per_second=4.0,
    )  # fmt: skip
    bar.below = below
    task = bar.add_task(printable(description), total=total, now="")
    shown = Bar(bar, task)
    # A clock of its own: the first step alone may take longer, where it has to compile.
    late = Timer(patience_s, bar.start) if where.is_terminal else Timer(LINE_EVERY_S, shown.tell)
    late.daemon = True
    late.start()
    try:
        yield shown
    finally:
        late.cancel()
        late.join()
        if where.is_terminal:
            bar.stop()


def print_json(values: Mapping[str, Any], file: IO[str] | None = None) -> None:
    """Write for machines: one JSON document; numpy's numbers as numbers, NaN and infinity as null.

    Raises:
        TypeError: a value that JSON cannot hold.
    """
    (file or sys.stdout).write(to_json(values) + "\n")


def busy() -> str:
    """Return a sentence where more threads want to run than there are cores, to stand beside times; else empty."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        load = os.getloadavg()[0]  # over the last minute
    except OSError:
        return ""
    if load <= cores:
        return ""
    return f"The machine was busy (load {load:.1f} on {cores} cores): times are longer than on an idle one."
