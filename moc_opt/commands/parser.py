"""The parser of `moc-opt`, and which function does each command; that is imported when the command runs."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from moc_opt import __version__
from moc_opt.commands import arguments
from moc_opt.robots.command import add_commands as add_robot_commands

WORK = {
    "run": "commands.running:run_scenario", "plan": "commands.ahead:plan_scenario",
    "export-c": "commands.exporting:export_c", "replay": "commands.pages:save_replay", "map": "commands.pages:save_map",
    "live": "commands.pages:serve_page", "report": "commands.reports:report_runs",
    "plant": "commands.wire:run_plant", "control": "commands.wire:run_control",
    "compare": "commands.studies:compare_solvers", "solvers": "commands.studies:list_or_study",
    "robots": "commands.listing:print_list", "tasks": "commands.listing:print_list",
    "metrics": "commands.listing:print_list", "keys": "commands.reference:print_keys",
    "robot": "robots.command:run_command",
}  # fmt: skip
"""Command -> module and function that does it: it takes the parsed options and returns the exit status."""


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
    _add_pages(commands)
    _add_wire(commands)
    add_robot_commands(commands)
    arguments.add_commands(commands)
    return parser


def _add_runs(commands: Any) -> None:
    """Add what runs, writes or plans one scenario."""
    one = commands.add_parser(
        "run", help="run one scenario and print its metrics",
        epilog="Exit status: 0 the run completed; 2 the input is wrong; 3 it was stopped, ran away or oscillated, "
        "and what is printed says so first; 130 interrupted, 1 a defect: with --trace the rows so far are there.",
    )  # fmt: skip
    one.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario runs")
    one.add_argument("--seed", type=int, help="replaces the scenario's seed")
    one.add_argument("--solver", help="replaces the scenario's solver")
    one.add_argument("--robot", metavar="NAME|MY.toml", help="replaces the scenario's robot")
    one.add_argument("--task", metavar="NAME|POINTS.csv", help="replaces the path; a file: x,y,z [m] a line")
    one.add_argument("--metric", action="append", metavar="NAME", help="print this metric alone; may be repeated")
    one.add_argument("--all", action="store_true", help="print every metric, not those alone to look at first")
    one.add_argument("--report", type=Path, metavar="FILE.html", help="metrics, curves and map of the run go here")
    one.add_argument("--force", action="store_true", help=arguments.FORCE)
    one.add_argument(
        "--third-level", choices=("local", "planned", "receding"), help="replaces the scenario's [control] third_level"
    )
    one.add_argument("--course", metavar="FILE.parquet", help="follow this course, written by `plan --out`")
    one.add_argument("--trace", type=Path, help="the trace goes here (Parquet); after Ctrl-C, the rows so far")
    one.add_argument("--json", action="store_true", help="print JSON")
    c = commands.add_parser("export-c", help="write the scenario's controller and safety filter as dependency-free C")
    c.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    c.add_argument("--out", type=Path, required=True, help="folder, made if need be")
    c.add_argument("--force", action="store_true", help="write over files that export-c has not written")
    c.add_argument("--main", choices=("test", "udp"), default="test", help="udp: also a controller for `plant`")
    ahead = commands.add_parser(
        "plan", help="say before anything moves whether and how well a scenario can be executed",
        epilog="Exit status: 0 the whole path can be executed from this start; 2 the input is wrong; 3 it cannot.",
    )  # fmt: skip
    ahead.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
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
    ahead.add_argument("--force", action="store_true", help=arguments.FORCE)
    ahead.add_argument("--json", action="store_true", help="print JSON")


def _add_pages(commands: Any) -> None:
    """Add what draws saved runs, and the live page."""
    replay = commands.add_parser("replay", help="one to four saved traces in 3-D, as one HTML file")
    replay.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes")
    replay.add_argument("--out", type=Path, default=Path("replay.html"), help="default replay.html")
    replay.add_argument("--force", action="store_true", help=arguments.FORCE)
    chart = commands.add_parser("map", help="saved traces of one path on the manipulability map, as one HTML file")
    chart.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes")
    chart.add_argument("--out", type=Path, default=Path("map.html"), help="default map.html")
    chart.add_argument("--force", action="store_true", help=arguments.FORCE)
    chart.add_argument("--figures", action="store_true", help="also as SVG and PDF, in a folder beside it")
    live = commands.add_parser("live", help="a scenario in real time, on a page of this machine")
    live.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    live.add_argument("--port", type=int, default=8642, help="0 to 65535, 0: any that is free; default 8642")


def _add_wire(commands: Any) -> None:
    """Add the two ends of a wire."""
    plant = commands.add_parser(
        "plant", help="the plant of a scenario in real time, for a controller at the other end of a wire",
        epilog="Exit status as of `run`. docs/realtime.md describes the wire.",
    )  # fmt: skip
    plant.add_argument("--listen", metavar="HOST:PORT", default="127.0.0.1:30200", help="default 127.0.0.1:30200")
    plant.add_argument("--lock-step", action="store_true", help="wait for each command instead of keeping the time")
    plant.add_argument("--trace", type=Path, help="the trace goes here (Parquet)")
    plant.add_argument("--all", action="store_true", help="print every metric, not those alone to look at first")
    control = commands.add_parser(
        "control", help="the controller of a scenario, for a plant at the other end of a wire",
        epilog="Exit status: 0 the plant ended the run; 2 the input is wrong; 3 the controller asked for a stop, or "
        "the plant fell silent.",
    )  # fmt: skip
    control.add_argument("--connect", metavar="HOST:PORT", default="127.0.0.1:30200", help="default 127.0.0.1:30200")
    for end in (plant, control):
        end.add_argument("scenario", nargs="?", type=Path, help="TOML, the same at both ends; without it the default")
        end.add_argument("--key-file", type=Path, help="one line of 16 to 32 bytes; else MOC_OPT_WIRE_KEY")
        end.add_argument("--json", action="store_true", help="print JSON")
