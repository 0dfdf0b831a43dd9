"""The arguments of the commands that compare, report and list, and the files that no command may overwrite."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from moc_opt.errors import TraceError

LISTS = {
    "robots": "the arms of the package",
    "tasks": "the paths that [task] path may name, and their sizes",
    "metrics": "what `run` prints of a run, with units",
}


def add_commands(commands: Any) -> None:
    """Add the commands to argparse's subparsers."""
    one = commands.add_parser("compare", help="solvers, and DCAC with the same gains, on the same random trials")
    one.add_argument("solvers", nargs="+", metavar="SOLVER", help="of `moc-opt solvers --list`")
    one.add_argument("--scenario", type=Path, metavar="FILE.toml", help="without it the default scenario")
    one.add_argument("--trials", type=int, default=15, help="from poses and swivels that the seed draws; default 15")
    one.add_argument("--seed", type=int, default=0, help="of the first trial; default 0")
    one.add_argument(
        "--keep-start", action="store_true", help="every trial starts as the scenario's [start] says, not at random"
    )
    one.add_argument("--out", type=Path, metavar="FILE.csv", help="one row a run goes here")
    one.add_argument("--json", action="store_true", help="print JSON")
    made = commands.add_parser("report", help="saved traces as one HTML file: metrics, curves, manipulability map")
    made.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes; a baseline first")
    made.add_argument("--out", type=Path, default=Path("report.html"), help="default report.html")
    study = commands.add_parser(
        "solvers", add_help=False,
        help="--list: which solvers there are; else the whole study of them, with options of its own",
    )  # fmt: skip
    study.add_argument("--list", action="store_true")
    study.add_argument("--json", action="store_true")
    for name, about in LISTS.items():
        commands.add_parser(name, help=about).add_argument("--json", action="store_true", help="print JSON")
    keys = commands.add_parser("keys", help="every key of a scenario: type, unit, default, meaning")
    keys.add_argument("table", nargs="?", help="of one table: task, control, control.supervisor, plant, ...")
    keys.add_argument("--markdown", action="store_true", help="print docs/scenario.md, or its part on that table")


def check_paths(given: argparse.Namespace) -> None:
    """Refuse to overwrite an input, and to write two results into one file.

    Raises:
        TraceError: names the option and the file.
    """
    read = [getattr(given, name, None) for name in ("scenario", "task", "key_file", "source", "course")]
    taken = {_place(path): "is read" for path in (*read, *getattr(given, "traces", ())) if path is not None}
    for name in ("trace", "report", "out"):
        path = getattr(given, name, None)
        if path is None:
            continue
        place = _place(path)
        if place in taken:
            raise TraceError(f"--{name} {path}: that file {taken[place]}; give another name")
        taken[place] = f"is written by --{name}"


def _place(path: Path | str) -> str:
    """Return the path without links; an invalid one (a loop, a NUL) unchanged: its reader reports the error."""
    try:
        return os.path.realpath(path)
    except (OSError, ValueError):
        return str(path)
