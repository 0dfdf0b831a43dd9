"""The terminal: tables in colour, a progress bar for what takes long, lines where the output is no terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from threading import Timer
from time import monotonic
from typing import IO, Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from moc_opt.inputs.files import to_json
from moc_opt.report.notation import printable

PATIENCE_S = 2.0
LINES_S = 10.0
T = TypeVar("T")


def console(*, stderr: bool = False, file: IO[str] | None = None) -> Console:
    """Make a console that writes plain text, without colour and uncut, where its output is no terminal.

    Args:
        stderr: write there; results belong on stdout, what accompanies them on stderr.
        file: write to it instead.
    """
    made = Console(stderr=stderr, file=file, highlight=False, soft_wrap=False)
    if not made.is_terminal:
        made.width = 10_000
    return made


class Bar:
    """A progress bar: `advance` it, say what it is `at`."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress, self._task = progress, task

    def advance(self, steps: float = 1.0) -> None:
        """Count so many more steps as done."""
        self._progress.update(self._task, advance=steps)

    def of(self, total: float) -> None:
        """Say how many steps there are, once that is known."""
        self._progress.update(self._task, total=total)

    def at(self, text: str) -> None:
        """Name what is being done now."""
        self._progress.update(self._task, now=printable(text))


class Lines(Bar):
    """The same for a file: a line now and then that says how far the work is."""

    def __init__(self, console: Console, description: str, total: float | None) -> None:
        self._console, self._what, self._total = console, description, total
        self._done, self._now, self._first = 0.0, "", 0.0
        self._said = self._began = monotonic()

    def advance(self, steps: float = 1.0) -> None:
        """Count so many more steps as done; say so where the last line is old enough."""
        now = monotonic()
        if self._done == 0.0:  # what comes before the first step, compiling, says nothing of the others
            self._began, self._first = now, steps
        self._done += steps
        if now - self._said < LINES_S:
            return
        self._said, counted = now, self._done - self._first
        of = "" if self._total is None else f" of {self._total:g}"
        left = (now - self._began) * ((self._total or 0.0) - self._done)
        time = f", about {left / counted:.0f} s left" if counted > 0.0 and left > 0.0 else ""
        self._console.print(f"{self._what}: {self._done:g}{of}{time}{self._now}", markup=False, soft_wrap=True)

    def of(self, total: float) -> None:
        """Say how many steps there are, once that is known."""
        self._total = total

    def at(self, text: str) -> None:
        """Name what is being done now."""
        self._now = f": {printable(text)}"


@contextmanager
def progress(
    description: str, total: float | None = None, *, on: Console | None = None, patience_s: float = PATIENCE_S
) -> Iterator[Bar]:
    """Show a bar with the time left on stderr, once `patience_s` is over and until the work is done.

    Where the output is no terminal, a line every `LINES_S` takes its place.

    Args:
        description: what is being done.
        total: steps in all; None where that is not known.
        on: the console to draw on.
        patience_s: seconds without a bar; work that is done by then never shows one.
    """
    where = on or console(stderr=True)
    if not where.is_terminal:
        yield Lines(where, printable(description), total)
        return
    bar = Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[now]}", style="dim", markup=False), console=where, transient=True,
    )  # fmt: skip
    task = bar.add_task(printable(description), total=total, now="")
    # A clock of its own: the first step alone may take longer than the patience.
    late = Timer(patience_s, bar.start)
    late.daemon = True
    late.start()
    try:
        yield Bar(bar, task)
    finally:
        late.cancel()
        late.join()
        bar.stop()


def track(items: Sequence[T], description: str, *, on: Console | None = None) -> Iterator[T]:
    """Go through `items` under a progress bar."""
    with progress(description, len(items), on=on) as bar:
        for item in items:
            yield item
            bar.advance()


def print_json(values: Mapping[str, Any], file: IO[str] | None = None) -> None:
    """Write for machines: one JSON document; numpy's numbers as numbers, NaN and infinity as null.

    Raises:
        TypeError: a value that JSON cannot hold.
    """
    (file or sys.stdout).write(to_json(values) + "\n")
