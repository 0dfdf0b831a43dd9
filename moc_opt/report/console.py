"""The terminal: tables in colour, a progress bar for what takes long, no bar where the output is no terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from threading import Timer
from typing import IO, Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from moc_opt.inputs.files import to_json
from moc_opt.report.notation import printable

PATIENCE_S = 2.0
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


@contextmanager
def progress(
    description: str, total: float | None = None, *, on: Console | None = None, patience_s: float = PATIENCE_S
) -> Iterator[Bar]:
    """Show a bar with the time left on stderr, once `patience_s` is over and until the work is done.

    Silent where the output is not a terminal.

    Args:
        description: what is being done.
        total: steps in all; None where that is not known.
        on: the console to draw on.
        patience_s: seconds without a bar; work that is done by then never shows one.
    """
    where = on or console(stderr=True)
    bar = Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[now]}", style="dim", markup=False), console=where, transient=True,
    )  # fmt: skip
    task = bar.add_task(printable(description), total=total, now="")
    # A clock of its own: the first step alone may take longer than the patience.
    late = Timer(patience_s, bar.start)
    late.daemon = True
    if where.is_terminal:
        late.start()
    try:
        yield Bar(bar, task)
    finally:
        if where.is_terminal:
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
