"""moc-opt robot new | check: make a robot file, and check an arm."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from moc_opt.inputs.files import decimal

VERDICTS = {"ok": "can be used", "care": "can be used with care", "cannot": "cannot be used"}


def add_commands(commands: Any) -> None:
    """Add ``robot new`` and ``robot check`` to argparse's subparsers."""
    robot = commands.add_parser("robot", help="make a robot file from a URDF, or check a robot")
    kinds = robot.add_subparsers(dest="robot_command", required=True)
    new = kinds.add_parser("new", help="write a robot file (TOML, and a URDF beside it) from any vendor's URDF")
    new.add_argument("source", type=Path, metavar="ARM.urdf")
    new.add_argument("--tip", metavar="LINK", help="link that carries the tool; default: the link of the last joint")
    new.add_argument("--tool", type=float, default=0.30, metavar="M", help="length of the tool [m]; default 0.3")
    new.add_argument(
        "--lock", action="append", default=[], type=_lock, metavar="JOINT[=VALUE]",
        help="fix this joint at VALUE [rad, m], by default at 0; may be repeated",
    )
    new.add_argument(
        "--base-rpy", nargs=3, type=float, default=(0.0, 0.0, 0.0), metavar=("R", "P", "Y"),
        help="roll, pitch, yaw of the base [rad]; with 3.1416 0 0 the arm hangs from the ceiling",
    )  # fmt: skip
    new.add_argument("--seed", type=int, default=0, help="seed of the search for a home pose")
    new.add_argument("--out", type=Path, required=True, metavar="MY.toml", help="robot file to write")
    check = kinds.add_parser(
        "check", help="check null space, reach, limits, gains and masses of a robot",
        epilog="Exit status: 0 the arm can be used; 3 it cannot; 2 the input is wrong.",
    )  # fmt: skip
    check.add_argument("robot", metavar="MY.toml|NAME", help="robot file, or a name from `moc-opt robots`")


def run_command(given: argparse.Namespace) -> int:
    """Run the command; return 0, or 3 if the verdict is "cannot"."""
    from rich.text import Text

    from moc_opt.report.console import console
    from moc_opt.report.tables import Column, Table
    from moc_opt.robots.check import check_robot, verdict
    from moc_opt.robots.model import load_robot
    from moc_opt.robots.new import new_robot

    out = console()
    if given.robot_command == "new":
        made = new_robot(
            given.source, given.out, tip=given.tip, tool_m=given.tool, lock=dict(given.lock),
            base_rpy=tuple(given.base_rpy), seed=given.seed,
        )  # fmt: skip
        print(made.toml, made.urdf, sep="\n")
        out.print("Assumptions and changes, also noted in the TOML file:")
        for note in made.notes:
            out.print(Text(f"- {note}"))
        robot = made.robot
    else:
        robot = load_robot(given.robot)
    findings = check_robot(robot)
    columns = [Column("what", "what"), Column("found", "found"), Column("verdict", "verdict")]
    out.print(Table(f"robot {robot.data.name}", columns, [row._asdict() for row in findings]))
    for row in findings:
        if row.cure:
            out.print(Text(f"{row.what}: {row.cure}"))
    worst = verdict(findings)
    out.print(Text(f"verdict: {robot.data.name} {VERDICTS[worst]}"))
    return 3 if worst == "cannot" else 0


def _lock(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    return name, decimal(value or "0")
