"""The hand-written C files of this package, and which of them a law needs."""

from __future__ import annotations

from importlib.resources import files

from moc_opt.embedded.symbolic import Tick

TICK = ("moc_dense", "moc_level3")
"""Files that the bare tick needs beside the generated ones."""
GUARDED = ("moc_arm.h", "moc_guard", "moc_incision", "moc_motion", "moc_replay", "moc_safe")
FALLBACK = ("moc_fallback", "moc_subproblem.h")
"""Files that it needs in addition if it solves."""
SINGULAR = ("moc_null_space",)
SOLVING = ("moc_supervisor", "moc_answer", "moc_singular")
UDP = ("wire_check", "wire_link", "udp.c")
"""The program that is a controller at the end of a wire; ``wire_packets.h`` is generated."""


def read(*names: str) -> dict[str, str]:
    """Read files, text by name; a name without an ending is a pair of .h and .c."""
    found: list[str] = []
    for name in names:
        found += [name] if "." in name else [f"{name}.h", f"{name}.c"]
    folder = files("moc_opt.embedded") / "c"
    return {name: (folder / name).read_text(encoding="utf-8") for name in found}


def solves(tick: Tick) -> bool:
    """Say whether the law of this tick solves a subproblem."""
    return any(field.name == "x" for field in tick.layout.report)


def bare(tick: Tick) -> dict[str, str]:
    """Read what the bare tick needs beside what is generated."""
    return read(*TICK, *(FALLBACK if solves(tick) else ()))


def guarded(tick: Tick) -> dict[str, str]:
    """Read supervisor, safety filter and the files that they need, for the law of this tick."""
    return read(*GUARDED, *(SINGULAR if tick.rows else ()), *(SOLVING if solves(tick) else ()))
