"""The command line of the benchmarks: common options, files, tables on the screen, errors and exit status.

A benchmark is a parser and a function that takes the parsed options and returns `Results`; `run` does the rest.
"""

from __future__ import annotations

import signal
import sys
import threading
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console

from benchmarks.common.answer import Answer
from benchmarks.common.index import write_index
from benchmarks.common.output import save_page, write_json, write_rows
from moc_opt.errors import MocOptError
from moc_opt.report.console import busy, console, progress
from moc_opt.report.page import Page
from moc_opt.report.tables import Table
from moc_opt.study.timing import with_doubts

WRONG, INTERRUPTED = 2, 130
"""Exit status after an error that is the user's or the machine's, and after Ctrl-C."""
BEGINS_ANEW = "stopped; nothing of it is kept: the same command begins anew"
GOES_ON = "stopped; what is finished is in {out}/jobs: the same command goes on from there"
"""Said after Ctrl-C."""


@dataclass(frozen=True)
class Results:
    """What a benchmark found.

    Attributes:
        summary: of summary.json: part -> solver or controller -> metric.
        environment: of environment.json, see `output.environment`.
        rows: of rows.parquet; None writes no such file.
        page: report.html; None writes no such file.
        tables: for the screen, each with as many of its first columns as fit.
        sentences: printed below the tables.
        files: names of files that the benchmark has written in the same folder by itself.
        status: exit status.
        answer: printed before the tables: the first screen of the page too.
    """

    summary: Mapping[str, Any]
    environment: Mapping[str, Any]
    rows: Iterable[Mapping[str, Any]] | None = None
    page: Page | None = None
    tables: Iterable[Table] = ()
    sentences: Iterable[str] = ()
    files: Sequence[str] = ()
    status: int = 0
    answer: Answer | None = None


def parser(name: str, about: str, *, configured: bool = True) -> ArgumentParser:
    """Make the parser with the options that every benchmark has.

    Args:
        name: of the command ``python -m benchmarks.NAME``.
        about: first line of ``--help``.
        configured: with CONFIG.toml, ``--seed``, ``--quick`` and ``--figures``; else ``--out`` and ``--json`` alone.
    """
    options = ArgumentParser(prog=f"python -m benchmarks.{name}", description=about)
    options.add_argument("--out", type=Path, default=Path("results") / name, help="folder for the results")
    options.add_argument("--json", action="store_true", help="print summary.json instead of tables")
    if configured:
        options.add_argument("config", nargs="?", type=Path, help=f"TOML; default: benchmarks/configs/{name}.toml")
        options.add_argument("--seed", type=seed_number, help="replaces the configuration's seed")
        options.add_argument("--quick", action="store_true", help="the same on less data")
        options.add_argument("--figures", action="store_true", help="every figure also as SVG and PDF")
    return options


def seed_number(text: str) -> int:
    """Read the number of ``--seed``; it replaces a configuration's and has the same range."""
    try:
        seed = int(text)
    except ValueError:
        seed = -1
    if not 0 <= seed <= 2**62:
        raise ArgumentTypeError(f"{text:.40}: give a whole number from 0 to 2^62")
    return seed


def whole_number(text: str) -> int:
    """Read the number of processes."""
    if not text.isascii() or not text.isdigit() or not 1 <= int(text[:5]) <= 1024:
        raise ArgumentTypeError(f"{text:.40}: give a whole number from 1 to 1024")
    return int(text)


def run(
    options: ArgumentParser, work: Callable[[Namespace], Results | int], arguments: Sequence[str] | None = None,
    stopped: str = BEGINS_ANEW,
) -> int:  # fmt: skip
    """Parse the command line, work, write and print the results; SIGTERM ends it as Ctrl-C does.

    Args:
        work: given the parsed options, with the texts they came from as ``argv``; an integer is an exit status.
        arguments: of the command; None: those of this process.
        stopped: said after Ctrl-C; ``{out}`` in it stands for the folder of the results.

    Returns:
        the exit status: that of the results, 2 after an error (one line on stderr), 130 after Ctrl-C.
    """
    given = options.parse_args(arguments)
    given.argv = sys.argv[1:] if arguments is None else list(arguments)
    given.busy = busy()  # by others: this benchmark has not begun
    try:
        with _sigterm_as_ctrl_c():
            found = work(given)
            if isinstance(found, int):
                return found
            leave(found, given)
            return found.status
    except (MocOptError, OSError) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return WRONG
    except KeyboardInterrupt:
        print(stopped.format(out=getattr(given, "out", "")), file=sys.stderr)
        return INTERRUPTED


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[None]:
    """Let SIGTERM end the work by an exception, so that the processes that it started are ended, too."""
    if threading.current_thread() is not threading.main_thread():  # no other thread may set a handler
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def leave(found: Results, given: Namespace) -> None:
    """Write the files of a benchmark and print its tables, or its summary with ``--json``."""
    out: Path = given.out
    files = ["summary.json", *(["rows.parquet"] if found.rows is not None else []), "environment.json"]
    write_json(out / "summary.json", with_doubts(found.summary))
    if found.rows is not None:
        write_rows(out / "rows.parquet", found.rows)
    write_json(out / "environment.json", found.environment)
    if found.page is not None:
        save_page(found.page, out / "report.html", figures=given.figures)
        files.append("report.html")
        write_index(out.parent)
    if given.json:
        print((out / "summary.json").read_text(encoding="utf-8"), end="")
        return
    screen = console()
    if found.answer is not None:
        show(screen, found.answer.screens(screen.width))
    for table in found.tables:
        screen.print(table.narrowed(screen.width))
    for sentence in found.sentences:
        screen.print(sentence, markup=False, soft_wrap=True)
    if getattr(given, "busy", "") and not (found.answer and found.answer.note):  # which says what was measured
        show(screen, [given.busy])
    screen.print(f"written: {out}/{' '.join([*files, *found.files])}", markup=False, soft_wrap=True)


def show(screen: Console, parts: Iterable[Any]) -> None:
    """Print tables, and sentences as paragraphs."""
    for part in parts:
        screen.print(part, markup=False)


class Step(Protocol):
    """Counts one step of a progress bar as done, and says which."""

    def __call__(self, text: str = "") -> None:
        """Count one more step, told as ``text``."""


@contextmanager
def steps(name: str, total: float | None = None) -> Iterator[Step]:
    """Show a progress bar; see `Step`."""
    with progress(name, total) as bar:

        def step(text: str = "") -> None:
            bar.at(text)
            bar.advance()

        yield step
