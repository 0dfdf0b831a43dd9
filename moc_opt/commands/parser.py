"""The arguments of `moc-opt`, and which function does each command; that is imported when the command runs."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from moc_opt import __version__
from moc_opt.errors import TraceError
from moc_opt.robots.command import add_commands as add_robot_commands

WORK = {
    "run": "commands.running:run_scenario", "plan": "commands.running:plan_scenario",
    "export-c": "commands.pages:export_c", "replay": "commands.pages:save_replay", "map": "commands.pages:save_map",
    "live": "commands.pages:serve_page", "report": "commands.pages:save_report",
    "plant": "commands.wire:run_plant", "control": "commands.wire:run_control",
    "compare": "commands.studies:compare_solvers", "solvers": "commands.studies:list_or_study",
    "robots": "commands.listing:print_list", "tasks": "commands.listing:print_list",
    "metrics": "commands.listing:print_list", "keys": "commands.reference:print_keys",
    "robot": "robots.command:run_command",
}  # fmt: skip
"""Command -> module and function that does it: it takes the parsed options and returns the exit status."""
FORCE = "write over a file that is no page of moc_opt"


def work_of(command: str) -> Callable[[argparse.Namespace], int]:
    """Import what does a command."""
    module, _, function = WORK[command].partition(":")
    found: Callable[[argparse.Namespace], int] = getattr(import_module(f"moc_opt.{module}"), function)
    return found


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of every command; ``command`` of what it parses is None where none is named."""
    parser = argparse.ArgumentParser(
        prog="moc-opt",
        description="moc-opt, or python -m moc_opt: scenarios, robots and solvers from the command line.",
    )
    parser.add_argument("--version", action="version", version=f"moc-opt {__version__}")
    commands = parser.add_subparsers(dest="command")
    _add_runs(commands)
    _add_plan(commands)
    _add_pages(commands)
    _add_wire(commands)
    add_robot_commands(commands)
    _add_studies_and_lists(commands)
    return parser


def _command(commands: Any, name: str, about: str, epilog: str = "", *, scenario: bool = True) -> Any:
    parser = commands.add_parser(name, help=about, epilog=epilog or None)
    if scenario:
        parser.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    return parser


def _add_json(*parsers: Any) -> None:
    for parser in parsers:
        parser.add_argument("--json", action="store_true", help="print JSON")


def _add_runs(commands: Any) -> None:
    one = _command(
        commands, "run", "run one scenario and print its metrics",
        "Exit status: 0 the run completed; 2 the input is wrong; 3 it was stopped, ran away or oscillated, "
        "and what is printed says so first; 130 interrupted, 1 a defect: with --trace the rows so far are there.",
    )  # fmt: skip
    one.add_argument("--seed", type=int, help="replaces the scenario's seed")
    one.add_argument("--solver", help="replaces the scenario's solver")
    one.add_argument("--robot", metavar="NAME|MY.toml", help="replaces the scenario's robot")
    one.add_argument("--task", metavar="NAME|POINTS.csv", help="replaces the path; a file: x,y,z [m] a line")
    one.add_argument("--metric", action="append", metavar="NAME", help="print this metric alone; may be repeated")
    one.add_argument("--all", action="store_true", help="print every metric, not those alone to look at first")
    one.add_argument("--report", type=Path, metavar="FILE.html", help="metrics, curves and map of the run go here")
    one.add_argument("--force", action="store_true", help=FORCE)
    one.add_argument(
        "--third-level", choices=("local", "planned", "receding"), help="replaces the scenario's [control] third_level"
    )
    one.add_argument("--course", metavar="FILE.parquet", help="follow this course, written by `plan --out`")
    one.add_argument("--trace", type=Path, help="the trace goes here (Parquet); after Ctrl-C, the rows so far")
    _add_json(one)


def _add_plan(commands: Any) -> None:
    ahead = _command(
        commands, "plan", "say before anything moves whether and how well a scenario can be executed",
        "Exit status: 0 the whole path can be executed from this start; 2 the input is wrong; 3 it cannot.",
    )  # fmt: skip
    ahead.add_argument(
        "--objective", choices=("mean", "worst", "log"), default="mean",
        help="what is made large: mean or worst mu along the path, or the mean of its logarithm",
    )
    ahead.add_argument(
        "--margin", type=float, metavar="RAD",
        help="what joints keep from their limits; default 0, or what a third level that follows a course keeps",
    )
    ahead.add_argument("--margin-m", type=float, metavar="M", help="the same for a joint that slides")
    ahead.add_argument(
        "--speed-share", type=float, metavar="S",
        help="share of the joints' speed limits that may be used, above 0 to 1; default 1, or what that level uses",
    )
    ahead.add_argument(
        "--acceleration", type=float, default=float("inf"), metavar="A",
        help="largest of any joint [rad/s^2]; default: no limit",
    )
    ahead.add_argument("--place", choices=("trocar", "base"), help="also search for the place of it that serves best")
    ahead.add_argument(
        "--box", type=float, metavar="M", help="with --place: half the edge of the cube searched; default 0.05"
    )
    ahead.add_argument("--candidates", type=int, metavar="N", help="with --place: places that are tried; default 40")
    ahead.add_argument("--out", type=Path, metavar="FILE.parquet", help="the course to follow goes here")
    ahead.add_argument("--force", action="store_true", help=FORCE)
    _add_json(ahead)


def _add_pages(commands: Any) -> None:
    for name, about in {
        "replay": "one to four saved traces in 3-D, as one HTML file",
        "map": "saved traces of one path on the manipulability map, as one HTML file",
        "report": "saved traces as one HTML file: metrics, curves, manipulability map",
    }.items():
        page = _command(commands, name, about, scenario=False)
        page.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes; a baseline first")
        page.add_argument("--out", type=Path, default=Path(f"{name}.html"), help=f"default {name}.html")
        page.add_argument("--force", action="store_true", help=FORCE)
        if name == "map":
            page.add_argument("--figures", action="store_true", help="also as SVG and PDF, in a folder beside it")
    live = _command(commands, "live", "a scenario in real time, on a page of this machine")
    live.add_argument("--port", type=int, default=8642, help="0 to 65535, 0: any that is free; default 8642")
    c = _command(commands, "export-c", "write the scenario's controller and safety filter as dependency-free C")
    c.add_argument("--out", type=Path, required=True, help="folder, made if need be")
    c.add_argument("--force", action="store_true", help="write over files that export-c has not written")
    c.add_argument("--main", choices=("test", "udp"), default="test", help="udp: also a controller for `plant`")


def _add_wire(commands: Any) -> None:
    plant = _command(
        commands, "plant", "the plant of a scenario in real time, for a controller at the other end of a wire",
        "Exit status as of `run`. docs/realtime.md describes the wire.",
    )  # fmt: skip
    plant.add_argument("--listen", metavar="HOST:PORT", default="127.0.0.1:30200", help="default 127.0.0.1:30200")
    plant.add_argument("--lock-step", action="store_true", help="wait for each command instead of keeping the time")
    plant.add_argument("--trace", type=Path, help="the trace goes here (Parquet)")
    plant.add_argument("--all", action="store_true", help="print every metric, not those alone to look at first")
    control = _command(
        commands, "control", "the controller of a scenario, for a plant at the other end of a wire",
        "Exit status: 0 the plant ended the run; 2 the input is wrong; 3 the controller asked for a stop, or "
        "the plant fell silent.",
    )  # fmt: skip
    control.add_argument("--connect", metavar="HOST:PORT", default="127.0.0.1:30200", help="default 127.0.0.1:30200")
    for end in (plant, control):
        end.add_argument("--key-file", type=Path, help="one line of 16 to 32 bytes; else MOC_OPT_WIRE_KEY")
    _add_json(plant, control)


def _add_studies_and_lists(commands: Any) -> None:
    one = _command(
        commands, "compare", "solvers, and DCAC with the same gains, on the same random trials", scenario=False
    )
    one.add_argument("solvers", nargs="+", metavar="SOLVER", help="of `moc-opt solvers --list`")
    one.add_argument("--scenario", type=Path, metavar="FILE.toml", help="without it the default scenario")
    one.add_argument("--trials", type=int, default=15, help="from poses and swivels that the seed draws; default 15")
    one.add_argument("--seed", type=int, default=0, help="of the first trial; default 0")
    one.add_argument(
        "--keep-start", action="store_true", help="every trial starts as the scenario's [start] says, not at random"
    )
    one.add_argument("--out", type=Path, metavar="FILE.csv", help="one row a run goes here")
    one.add_argument("--force", action="store_true", help=FORCE)
    study = commands.add_parser(
        "solvers", add_help=False,
        help="--list: which solvers there are; else the whole study of them, with the options of benchmarks.solvers",
    )  # fmt: skip
    study.add_argument("--list", action="store_true")
    robots = _command(commands, "robots", "the arms of the package", scenario=False)
    tasks = _command(commands, "tasks", "the paths that [task] path may name, and their sizes", scenario=False)
    metrics = _command(commands, "metrics", "what `run` prints of a run, with units", scenario=False)
    _add_json(one, study, robots, tasks, metrics)
    keys = _command(commands, "keys", "every key of a scenario: type, unit, default, meaning", scenario=False)
    keys.add_argument("table", nargs="?", help="of one table: task, control, control.supervisor, plant, ...")
    keys.add_argument("--markdown", action="store_true", help="print docs/scenario.md, or its part on that table")


def check_paths(given: argparse.Namespace) -> None:
    """Refuse to overwrite an input, and to write two results into one file; a TraceError names option and file."""

    def place(path: Path | str) -> str:
        try:
            return os.path.realpath(path)
        except (OSError, ValueError):
            return str(path)  # a loop of links, a NUL: whoever reads it says so

    read = [getattr(given, name, None) for name in ("scenario", "task", "key_file", "source", "course")]
    taken = {place(path): "is read" for path in (*read, *getattr(given, "traces", ())) if path is not None}
    for name in ("trace", "report", "out"):
        path = getattr(given, name, None)
        if path is None:
            continue
        if place(path) in taken:
            raise TraceError(f"--{name} {path}: that file {taken[place(path)]}; give another name")
        taken[place(path)] = f"is written by --{name}"
