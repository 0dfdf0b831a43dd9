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
    """A command and its help."""

    work: str  #: "module:function" in moc_opt; the function returns the exit status
    about: str  #: short help
    options: tuple[Option, ...]
    ends: str = ""  #: end of the help


def option(*names: str, **settings: Any) -> Option:
    """Declare an option for argparse's add_argument."""
    return names, settings


def path(text: str) -> Path:
    """Return a path. Refuse "", which means the current folder."""
    if not text:
        raise argparse.ArgumentTypeError("the path is empty: give a path")
    return Path(text)


def flag(name: str, about: str) -> Option:
    """Declare an option without a value."""
    return option(name, action="store_true", help=about)


def pages(name: str) -> tuple[Option, ...]:
    """Declare the options of a command that writes NAME.html from traces."""
    return (
        option("traces", nargs="+", type=path, help="files of `moc-opt run --trace`, shown in this order"),
        option("--out", type=path, default=Path(f"{name}.html"), help=f"HTML file to write; default {name}.html"),
        FORCE,
    )


SCENARIO = option("scenario", nargs="?", type=path, help="TOML file; if left out, all settings have their defaults")
FORCE = flag("--force", "overwrite a file even if moc_opt did not write it")
JSON = flag("--json", "print JSON instead of tables")
ALL = flag("--all", "print all metrics, not only the main metrics")
KEY = option("--key-file", type=path, help="file with the shared key (16 to 32 bytes); default: $MOC_OPT_WIRE_KEY")
WIRE = "127.0.0.1:30200"

COMMANDS = {
    "run": Command("commands.running:run_scenario", "run one scenario and print its metrics", (
        SCENARIO,
        option("--seed", type=int, help="seed of random numbers; replaces the scenario's seed"),
        option("--solver", help="solver, with default settings: a name from `moc-opt solvers --list`"),
        option("--robot", metavar="NAME|MY.toml", help="robot: a name from `moc-opt robots`, or a robot file"),
        option("--task", metavar="NAME|POINTS.csv",
               help="path: a name from `moc-opt tasks`, or a file with one point x,y,z [m] per line"),
        option("--metric", action="append", metavar="NAME", help="print only this metric; may be repeated"),
        ALL,
        option("--report", type=path, metavar="FILE.html", help="write a page with metrics, curves and map"),
        FORCE,
        option("--third-level", choices=("local", "planned", "receding"),
               help="motion of the elbow. local: up the gradient of the manipulability; planned: along a joint motion "
                    "planned before the run; receding: along a joint motion that is replanned during the run"),
        option("--course", metavar="FILE.parquet",
               help="follow the joint motion in this file of `moc-opt plan --out` (implies --third-level planned)"),
        option("--trace", type=path, metavar="X.parquet", help="write the record of the run (trace) to this file"),
        JSON,
    ), "Exit status: 0 the run completed; 1 an internal error; 2 the input is wrong; 3 the run was stopped, ran away "
       "or oscillated (the first line of the output says which); 130 interrupted. After 1 or 130, the file of --trace "
       "contains the part of the run before the break."),
    "plan": Command("commands.running:plan_scenario",
                    "check that the arm can follow the path, and plan its joint motion", (
        SCENARIO,
        option("--margin", type=float, metavar="RAD",
               help="keep revolute joints this far from their limits"),
        option("--margin-m", type=float, metavar="M", help="keep prismatic joints this far from their limits"),
        option("--speed-share", type=float, metavar="S",
               help="keep the speed of each joint below this share of its speed limit"),
        option("--out", type=path, metavar="FILE.parquet", help="write the joint motion (course) to this file"),
        FORCE,
        JSON,
    ), "With --out, or if the scenario has third_level = 'planned' or 'receding', the defaults are those of [control]: "
       "course_margin_rad for --margin, limit_margin_m for --margin-m (but 0 for one of these two if you give the "
       "other), and course_speed_fraction for --speed-share. In all other cases, the margins default to 0, and "
       "--speed-share to 1. Exit status: 0 the arm can follow the whole path from this start; 2 the input is wrong; "
       "3 the arm cannot."),
    "replay": Command("commands.making:save_page", "show one to four saved runs in 3-D, in one HTML file",
                      pages("replay")),
    "map": Command("commands.making:save_page", "show saved runs of one path on a manipulability map, in one HTML file",
                   (*pages("map"), flag("--figures", "also write the figures as SVG and PDF"))),
    "report": Command("commands.making:save_page",
                      "show metrics, curves and map of saved runs, in one HTML file", pages("report")),
    "live": Command("commands.making:serve_page", "run a scenario in real time, on a local web page", (
        SCENARIO,
        option("--port", type=int, default=8642, help="port of the web page; default 8642; 0 means any free port"),
    )),
    "export-c": Command("commands.making:export_c",
                        "write the scenario's controller and safety filter as C code", (
        SCENARIO,
        option("--out", type=path, required=True, help="folder for the C code; created if missing"),
        flag("--force", "overwrite files that export-c did not write"),
        option("--main", choices=("test", "udp"), default="test",
               help="test: write a self-test; udp: write a self-test, and a program that controls `moc-opt plant`"),
    )),
    "plant": Command("commands.running:run_plant",
                     "simulate the arm in real time, for a controller over UDP", (
        SCENARIO,
        option("--listen", metavar="HOST:PORT", default=WIRE, help=f"address of this plant; default {WIRE}"),
        flag("--lock-step", "wait for each command of the controller instead of running in real time"),
        option("--trace", type=path, metavar="FILE.parquet", help="write the record of the run (trace) to this file"),
        FORCE,
        ALL,
        KEY,
        JSON,
    ), "Exit status: as for `moc-opt run`. docs/realtime.md describes the protocol."),
    "control": Command("commands.running:run_control",
                       "run the controller for `moc-opt plant`, over UDP", (
        SCENARIO,
        option("--connect", metavar="HOST:PORT", default=WIRE, help=f"address of the plant; default {WIRE}"),
        KEY,
        JSON,
    ), "Exit status: 0 the plant ended the run after the last tick; 2 the input is wrong; 3 the controller asked for a "
       "stop, or the plant ended the run early or fell silent."),
    "compare": Command("commands.making:compare_solvers",
                       "compare solvers with each other, and with control of tip and shaft alone, on random trials", (
        option("solvers", nargs="+", metavar="SOLVER", help="names from `moc-opt solvers --list`"),
        option("--scenario", type=path, metavar="FILE.toml",
               help="scenario of all trials; if left out, all settings have their defaults"),
        option("--trials", type=int, default=15, help="number of random start poses; default 15"),
        option("--seed", type=int, default=0, help="seed of the first trial; default 0"),
        option("--out", type=path, metavar="FILE.csv", help="write one row per run to this file"),
        FORCE,
        JSON,
    )),
    "solvers": Command("commands.making:list_or_study",
                       "compare all solvers in a study (some minutes), or list them",
                       (flag("--list", "print the installed solvers and their settings"), JSON)),
    "robots": Command("commands.listing:print_list", "list the arms of the package", (JSON,)),
    "tasks": Command("commands.listing:print_list", "list the paths of the tip, and their sizes", (JSON,)),
    "metrics": Command("commands.listing:print_list", "list the metrics of a run, with units and meanings", (JSON,)),
    "keys": Command("commands.reference:print_keys", "list the settings of a scenario: type, default and meaning", (
        option("table", nargs="?", help="list only this table, such as task or control.supervisor"),
        flag("--markdown", "print Markdown: the page docs/scenario.md, or only its section on the given table"),
    )),
}  # fmt: skip
"""All commands except `robot`."""


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
