"""Write the exported folder of C files."""

from __future__ import annotations

import hashlib
import math
import os
import textwrap
from collections.abc import Iterable, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import ScenarioError
from moc_opt.inputs.files import as_path, check_replaceable, write_whole
from moc_opt.robots.model import RobotModel

CORE = (
    "moc.h", "vec.h", "shared.h", "arm.c", "manipulability.c", "law.c", "null_space.c", "exact.c", "polytope.c",
    "answer.c", "safety_filter.c", "step.c", "record.c",
)  # fmt: skip
"""The files of `moc_opt/core` that `moc_step` needs."""
TESTS = ("main.c", "Makefile", "README.md")
UDP = ("udp.c",)
OWN = files("moc_opt.export") / "c"
MARK = "Written by moc-opt export-c"  # in the first line of every exported text file
SUPERVISION = (
    "check", "box_limit", "primal_limit", "relative_limit", "opposite_limit", "hold_ticks", "keep_off_limits",
    "fallback", "late", "budget_us",
)  # fmt: skip
"""The fields of moc_supervision."""


class Recording(NamedTuple):
    """k consecutive ticks."""

    q: Array  # (k, n) [rad]; may be NaN
    v: Array  # (k, n) [rad/s]
    stamp: Array  # (k,) number of the control period in which q and v were measured
    tip_ref: Array  # (k, 3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2]
    trocar: Array  # (k, 2, 3) rows P_t [m], dP_t [m/s]
    wrench: Array  # (k, 6) force [N] and torque [Nm] of the tool on its mount, tool axes
    tau: Array  # (k, n) torque after the safety filter [Nm]
    sent: Array  # (n,) torque before the first tick [Nm]
    sound: int  # The first `sound` ticks have no faults.
    stopped_at: int  # tick of the stop, or -1


def shipped(folder: Traversable, names: Iterable[str]) -> dict[str, str]:
    """Return the texts of files in a folder of the package, by name."""
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def in_c(value: Any) -> str:
    """Return a value as an initialiser in C, exact to the last bit."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f".{name} = {in_c(part)}" for name, part in value.items()) + "}"
    if isinstance(value, list | tuple | np.ndarray):
        return "{" + ", ".join(map(in_c, value)) + "}"
    if isinstance(value, int | np.integer | np.bool_):
        return str(int(value))
    if math.isnan(value):
        return "NAN"
    return repr(float(value)) if math.isfinite(value) else "INFINITY" if value > 0.0 else "-INFINITY"


def defined(declaration: str, value: Any) -> str:
    """Return a definition in C, broken into lines."""
    return textwrap.fill(
        f"{declaration} = {in_c(value)};", 120, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )


def arm_in_c(robot: RobotModel) -> dict[str, Any]:
    """Return the fields of moc_arm."""
    joints, points, tool, moves, gravity = robot.arm_arrays
    return {
        "n": robot.n,
        "joint": [
            {
                "rotation": joint[:9].reshape(3, 3), "origin": joint[9:12], "axis": joint[12:15],
                "slides": joint[15], "mass": joint[16], "moment": joint[17:20], "inertia": joint[20:26],
                "rotor": joint[26],
            }
            for joint in joints
        ],
        "point": points, "tool": tool, "moves": moves.astype(int), "gravity": gravity,
    }  # fmt: skip


def constants(
    robot: RobotModel, law: Mapping[str, Any], guard: Mapping[str, Any], tolerance: float, stop: tuple[float, float]
) -> dict[str, str]:
    """Return the texts of constants.h and constants.c. `write` describes the arguments."""
    header = f"""\
/* The scenario's numbers. Pass moc_constants to moc_start and moc_step. */
#ifndef CONSTANTS_H
#define CONSTANTS_H

#include "moc.h"

#define JOINTS {robot.n}
#define PERIOD_S {in_c(law["period"])} /* control period [s] */
#define STOP_DAMPING {in_c(stop[0])} /* damping of the drives in a stop [Nm s/rad] */
#define STOP_S {in_c(stop[1])} /* shortest duration of a stop [s] */

extern const moc_controller moc_constants;

#endif
"""
    parts = {
        "moc_arm arm": arm_in_c(robot),
        "moc_law law": {name: value for name, value in law.items() if name not in SUPERVISION},
        "moc_supervision supervision": {name: law[name] for name in SUPERVISION},
        "moc_guard guard": guard,
    }
    body = "\n\n".join(defined(f"static const {name}", value) for name, value in parts.items())
    whole = f"const moc_controller moc_constants = {{&arm, &law, &supervision, &guard, {in_c(tolerance)}}};"
    return {"constants.h": header, "constants.c": f'#include <math.h>\n\n#include "constants.h"\n\n{body}\n\n{whole}\n'}


def recording_in_c(recording: Recording) -> str:
    """Return the text of recording.h."""
    r = recording
    columns = zip(r.q, r.v, r.stamp.astype(int), r.tip_ref, r.trocar, r.wrench, r.tau, strict=True)
    return f"""\
/* Recorded ticks of the Python controller. Only the last {len(r.q) - r.sound} ticks can have faulty inputs. */
#include <math.h>

#include "constants.h"

enum {{ TICKS = {len(r.q)}, SOUND = {r.sound}, STOPPED_AT = {r.stopped_at} }};

{defined("static const double sent[JOINTS]", r.sent)}

static const struct {{
    double q[JOINTS], v[JOINTS];
    long long stamp;
    moc_reference ref;
    moc_trocar trocar;
    double wrench[6], tau[JOINTS];
}} {defined("recorded[TICKS]", list(columns))}
"""


def write(
    robot: RobotModel, law: Mapping[str, Any], guard: Mapping[str, Any], recording: Recording,
    out: str | os.PathLike[str], *, tolerance: float, stop: tuple[float, float],
    extra: Mapping[str, str | bytes] = MappingProxyType({}), force: bool = False,
) -> list[Path]:  # fmt: skip
    """Write the folder, and return its files.

    Args:
        law: values of the fields of moc_law and moc_supervision.
        guard: values of the fields of moc_guard.
        tolerance: tolerance of the solver ``exact`` [rad/s].
        stop: damping of the drives [Nm s/rad] and shortest duration [s] of a stop.
        extra: further files by name.
        force: also overwrite files that were edited, or that export-c did not write.

    Raises:
        ScenarioError: ``out`` cannot be written, or has files that only ``force`` overwrites.
    """
    texts: dict[str, str | bytes] = {**shipped(files("moc_opt.core"), CORE), **shipped(OWN, TESTS)}
    texts |= constants(robot, law, guard, tolerance, stop) | {"recording.h": recording_in_c(recording)} | dict(extra)
    parts = [name for name in (*CORE, "constants.c") if name.endswith(".c")]
    texts["Makefile"] = str(texts["Makefile"]).replace("@parts@", " ".join(parts))
    folder = as_path(out, "out =", ScenarioError)
    check_replaceable(folder / "Makefile", f"out = {str(folder)!r}: file", ScenarioError)
    kept = [name for name in texts if (folder / name).exists() and not _is_own(folder / name)]
    if kept and not force:
        raise ScenarioError(
            f"out = {str(folder)!r}: {', '.join(kept)} in it {'is' if len(kept) == 1 else 'are'} edited, or "
            "not from export-c: name another folder, or give --force to overwrite"
        )
    return [
        write_whole(folder / name, text if isinstance(text, bytes) else _marked(name, text), "out =", ScenarioError)
        for name, text in texts.items()
    ]


def _marked(name: str, text: str) -> str:
    comments = {".c": ("/* ", " */"), ".h": ("/* ", " */"), ".md": ("<!-- ", " -->")}
    before, after = comments.get(Path(name).suffix, ("# ", ""))
    check = hashlib.blake2s(text.encode(), digest_size=8).hexdigest()
    return f"{before}{MARK} ({check}). SPDX-License-Identifier: Apache-2.0{after}\n{text}"


def _is_own(file: Path) -> bool:
    if file.suffix == ".bin":  # binary files have no mark
        return (file.parent / "udp.c").exists()
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return text == _marked(file.name, text.partition("\n")[2])
