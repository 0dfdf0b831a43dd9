"""The commands of `moc-opt` as data, in `COMMANDS`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from moc_opt import __version__
from moc_opt.robots.command import add_commands as add_robot_commands

Option = tuple[tuple[str, ...], dict[str, Any]]


class Command(NamedTuple):
    """A command with its options and help texts."""

    work: str  #: "module:function" in moc_opt, called with the parsed options
    about: str
    options: tuple[Option, ...]
    ends: str = ""


def option(*names: str, **settings: Any) -> Option:
    """Declare an option with the settings of argparse's add_argument."""
    return names, settings


def path(text: str) -> Path:
    """Return the text as a path; refuse "", which would be the current folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty: give one")
    return Path(text)


def flag(name: str, about: str) -> Option:
    """Declare an option without a value."""
    return option(name, action="store_true", help=about)


def pages(name: str) -> tuple[Option, ...]:
    """Declare the options of a command that writes NAME.html from traces."""
    return (
        option("traces", nargs="+", type=path, help="files (Parquet) that `run --trace` wrote; give a baseline first"),
        option("--out", type=path, default=Path(f"{name}.html"), help=f"default {name}.html"),
        FORCE,
    )


SCENARIO = option("scenario", nargs="?", type=path, help="TOML file; default: the default scenario")
FORCE = flag("--force", "overwrite a file even if moc_opt did not write it")
JSON = flag("--json", "print JSON")
ALL = flag("--all", "print every metric, not the short selection")
KEY = option("--key-file", type=path, help="file with a key of 16 to 32 bytes; default: $MOC_OPT_WIRE_KEY")
WIRE = "127.0.0.1:30200"

COMMANDS = {
    "run": Command("commands.running:run_scenario", "run one scenario and print its metrics", (
        SCENARIO,
        option("--seed", type=int, help="replaces the scenario's seed"),
        option("--solver", help="replaces the solver, with default settings; `solvers --list` has the names"),
        option("--robot", metavar="NAME|MY.toml", help="replaces the scenario's robot"),
        option("--task", metavar="NAME|POINTS.csv", help="name from `tasks`, or a file with one x,y,z [m] per line"),
        option("--metric", action="append", metavar="NAME", help="print only this metric; may be repeated"),
        ALL,
        option("--report", type=path, metavar="FILE.html", help="write metrics, curves and map to this page"),
        FORCE,
        option("--third-level", choices=("local", "planned", "receding"), help="local: climb mu; else follow a course"),
        option("--course", metavar="FILE.parquet", help="follow this course, written by `plan --out`"),
        option("--trace", type=path, metavar="X.parquet", help="write the trace to this file, even after Ctrl-C"),
        JSON,
    ), "Exit status: 0 the run completed; 2 the input is wrong; 3 the run was stopped, ran away or oscillated (the "
       "first line says so); 130 interrupted; 1 an internal error. After 130 and 1, --trace has the rows so far."),
    "plan": Command("commands.running:plan_scenario",
                    "plan a scenario: whether and how well it can be executed", (
        SCENARIO,
        option("--margin", type=float, metavar="RAD",
               help="distance from the joint limits; default 0, or course_margin_rad if a course is followed"),
        option("--margin-m", type=float, metavar="M", help="distance of sliding joints from their limits"),
        option("--speed-share", type=float, metavar="S",
               help="share of the joints' speed limits that a course may use, above 0 to 1; default 1, or "
                    "course_speed_fraction if a course is followed (with --out, third_level planned or receding)"),
        option("--out", type=path, metavar="FILE.parquet", help="write the course to this file"),
        FORCE,
        JSON,
    ), "Exit status: 0 the whole path can be executed from this start; 3 it cannot; 2 path or input is unusable."),
    "replay": Command("commands.making:save_page", "show one to four saved traces in 3-D, in one HTML file",
                      pages("replay")),
    "map": Command("commands.making:save_page", "show saved traces of one path on the map of mu, in one HTML file",
                   (*pages("map"), flag("--figures", "also write the figures as SVG and PDF"))),
    "report": Command("commands.making:save_page",
                      "show saved traces in one HTML file: metrics, curves, manipulability map", pages("report")),
    "live": Command("commands.making:serve_page", "run a scenario in real time, on a page of this machine", (
        SCENARIO,
        option("--port", type=int, default=8642, help="port, 0 to 65535; 0 takes any free port; default 8642"),
    )),
    "export-c": Command("commands.making:export_c",
                        "write the scenario's controller and safety filter as dependency-free C", (
        SCENARIO,
        option("--out", type=path, required=True, help="folder; it is made if it does not exist"),
        flag("--force", "write over files that export-c has not written"),
        option("--main", choices=("test", "udp"), default="test", help="udp: also write a client of `moc-opt plant`"),
    )),
    "plant": Command("commands.running:run_plant",
                     "run the plant of a scenario in real time, for a controller over UDP", (
        SCENARIO,
        option("--listen", metavar="HOST:PORT", default=WIRE, help=f"default {WIRE}"),
        flag("--lock-step", "wait for each command instead of running in real time"),
        option("--trace", type=path, metavar="FILE.parquet", help="write the trace to this file"),
        FORCE,
        ALL,
        KEY,
        JSON,
    ), "Exit status: as for `run`. docs/realtime.md describes the protocol."),
    "control": Command("commands.running:run_control",
                       "run the controller of a scenario, for a plant over UDP", (
        SCENARIO,
        option("--connect", metavar="HOST:PORT", default=WIRE, help=f"default {WIRE}"),
        KEY,
        JSON,
    ), "Exit status: 0 the plant ended the run; 2 the input is wrong; 3 the controller asked for a stop, or the plant "
       "fell silent."),
    "compare": Command("commands.making:compare_solvers",
                       "compare solvers, and DCAC with equal gains, on the same random trials", (
        option("solvers", nargs="+", metavar="SOLVER", help="names from `moc-opt solvers --list`"),
        option("--scenario", type=path, metavar="FILE.toml", help="default: the default scenario"),
        option("--trials", type=int, default=15, help="number of random start poses and swivels; default 15"),
        option("--seed", type=int, default=0, help="seed of the first trial; default 0"),
        option("--out", type=path, metavar="FILE.csv", help="write one row per run to this file"),
        FORCE,
        JSON,
    )),
    "solvers": Command("commands.making:list_or_study",
                       "run the study of all solvers (some minutes), or list them",
                       (flag("--list", "print the solvers that can run here, and their settings"), JSON)),
    "robots": Command("commands.listing:print_list", "list the arms of the package", (JSON,)),
    "tasks": Command("commands.listing:print_list", "list the paths for [task] path, and their sizes", (JSON,)),
    "metrics": Command("commands.listing:print_list", "list the metrics of a run, with meaning and unit", (JSON,)),
    "keys": Command("commands.reference:print_keys", "list every key of a scenario: type, unit, default, meaning", (
        option("table", nargs="?", help="list only this table: task, control, control.supervisor, plant, ..."),
        flag("--markdown", "print docs/scenario.md, or its part on that table"),
    )),
}  # fmt: skip
"""All commands except `robot`, in the order of the help."""


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of all commands."""
    parser = argparse.ArgumentParser(
        prog="moc-opt",
        description="moc-opt, or python -m moc_opt: scenarios, robots and solvers from the command line.",
    )
    parser.add_argument("--version", action="version", version=f"moc-opt {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, command in COMMANDS.items():
        # `solvers` passes --help on to the study.
        one = commands.add_parser(name, help=command.about, epilog=command.ends or None, add_help=name != "solvers")
        for names, settings in command.options:
            one.add_argument(*names, **settings)
    add_robot_commands(commands)
    return parser


def work_of(command: str) -> Callable[[argparse.Namespace], int]:
    """Import and return the function of a command."""
    work = "robots.command:run_command" if command == "robot" else COMMANDS[command].work
    module, _, function = work.partition(":")
    found: Callable[[argparse.Namespace], int] = getattr(import_module(f"moc_opt.{module}"), function)
    return found
