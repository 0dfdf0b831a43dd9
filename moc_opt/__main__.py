"""Run moc-opt, and turn an error into one line and an exit status."""

from __future__ import annotations

import errno
import os
import select
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from moc_opt.errors import MocOptError, describe


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0, 1 (a bug), 2 (wrong input), 3 (run incomplete) or 130 (Ctrl-C)."""
    try:
        try:
            return _command(arguments)
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except OSError as error:
        full = error.errno == errno.ENOSPC
        if not full and not (isinstance(error, BrokenPipeError) and _nobody_reads()):
            raise
        from moc_opt.report.console import end_output

        closed = end_output()
        if not full:
            return closed
        print(_one_line(error), file=sys.stderr)
        return 2


def _nobody_reads() -> bool:
    watched = select.poll()
    watched.register(sys.stdout.fileno(), 0)
    return bool(watched.poll(0))


def _command(arguments: Sequence[str] | None) -> int:
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        warnings.formatwarning = lambda text, *_, **__: f"{text}\n"
        from moc_opt.commands.parser import COMMANDS, make_parser, work_of  # slow: in the try, for Ctrl-C

        parser = make_parser()
        if "_ARGCOMPLETE" in os.environ:  # a shell asks for completions
            import argcomplete

            argcomplete.autocomplete(parser)
        given, rest = parser.parse_known_args(arguments)
        given.rest = rest  # options of the solver study
        if given.command is None:
            parser.error("no command: `moc-opt run` runs the default scenario, `moc-opt -h` explains all commands")
        if rest and (given.command != "solvers" or given.list):
            options = COMMANDS[given.command].options if given.command in COMMANDS else ()
            near = get_close_matches(rest[0].partition("=")[0], [name for names, _ in options for name in names], 1)
            meant = f", did you mean {near[0]}?" if near else ":"
            parser.error(f"unrecognized arguments: {' '.join(rest)}{meant} `moc-opt {given.command} -h` lists options")
        from moc_opt.report.console import divert_output

        with divert_output(getattr(given, "json", False)):
            return work_of(given.command)(given)
    except (Exception, KeyboardInterrupt) as error:
        refused = isinstance(error, MocOptError | MemoryError)
        status = 130 if isinstance(error, KeyboardInterrupt) else 2 if refused else 1
        if isinstance(error, BrokenPipeError) or (status == 1 and not hasattr(error, "__notes__")):
            raise  # a bug shows its traceback, unless notes say where the run was saved
        print(_one_line(error), file=sys.stderr)
        return status


def _one_line(error: BaseException) -> str:
    said = "interrupted" if isinstance(error, KeyboardInterrupt) else f"{type(error).__name__}: {error}"
    where = ""
    if not isinstance(error, MocOptError | MemoryError | KeyboardInterrupt):
        at = traceback.extract_tb(error.__traceback__)[-1]
        said, where = describe(error), f" ({Path(at.filename).name}:{at.lineno})"
    return "; ".join([said + where, *getattr(error, "__notes__", [])])


if __name__ == "__main__":
    sys.exit(main())
