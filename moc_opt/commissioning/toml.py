"""The robot file of a new arm as text, each number with where it comes from."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np

from moc_opt.commissioning.home import Home
from moc_opt.commissioning.shaft import Shaft
from moc_opt.commissioning.vendor import VendorArm, chain_joints
from moc_opt.model.gains import Table

_WIDTH = 112


def robot_toml(
    name: str, arm: VendorArm, shaft: Shaft, tool_m: float, drives: Mapping[str, Sequence[float]],
    q: Sequence[float] | np.ndarray, *, home: Home | None = None, gains: Mapping[str, Table] | None = None,
) -> str:  # fmt: skip
    """Write a robot file.

    Args:
        name: of the robot; its URDF is ``name``.urdf beside it.
        tool_m: mount to tip [m].
        drives: the keys of [joints], one number per joint.
        q: (n,) the home pose [rad, m].
        home: why that pose; None for a draft.
        gains: tables of gains; None: none are written, and the loader derives them.
    """
    slides = any(joint.get("type") == "prismatic" for joint in chain_joints(arm))
    parts = [
        f"# {name}, made by: moc-opt robot new. What was assumed:",
        *(line for note in arm.notes for line in _wrapped(note)),
        "# Numbers that are not the vendor's are ours; look at every one before it meets a real arm.",
        "",
        f'name = "{name}"',
        f'urdf = "{name}.urdf"  # relative to this file; joint limits are in it',
        "",
        "[frames]",
        f'last_link = "{arm.last_link}"  # the link that carries the tool',
        "# The point on the shaft that is used as wrist, and where the tool begins; it runs along z of the mount.",
        f"wrist_xyz_m = {_list(shaft.wrist)}",
        f"tool_mount_xyz_m = {_list(shaft.mount)}",
        f"tool_mount_rpy_rad = {_list(shaft.rpy)}",
        "",
        "[tool]  # a slender rod; mass and radius are ours",
        f"length_m = {tool_m!r}",
        "mass_kg = 0.3",
        "radius_m = 0.004",
        "",
        f"# Drives, ours: by the torque limit{'; kg, N s/m and N for a joint that slides' if slides else ''}.",
        "[joints]",
        *(f"{key} = {_list(values)}" for key, values in drives.items()),
        "",
    ]
    if home is not None:
        parts += [
            f"# Found by search: at least {100 * home.margin:.0f} % of half of its range from every limit; mu is",
            f"# {home.mu:.3g} where {home.mu_best:.3g} is within reach of a self-motion.",
        ]
    parts += ["[home]", f"q_rad = {_list(q)}"]
    if gains:
        parts += [
            "",
            "# Derived from the arm's inertia (moc_opt.model.gains): K_X, D_X at the tip, K_N, D_N at the wrist point",
            f"# [N/m, N s/m], K_N2, D_N2 per joint [N m s/rad{', N s/m where it slides' if slides else ''}].",
        ]
    for table, values in (gains or {}).items():
        parts.append(f"[gains.{table}]")
        parts += [f"{key} = {_list(v) if isinstance(v, tuple) else repr(v)}" for key, v in values.items()]
        parts.append("")
    return "\n".join(parts).rstrip() + "\n"


def _list(values: Sequence[float] | np.ndarray) -> str:
    # Twelve decimals: smaller parts are rounding, and a number below 1e-30 is refused when the file is read.
    return f"[{', '.join(repr(round(float(value), 12) + 0.0) for value in values)}]"


def _wrapped(note: str) -> list[str]:
    """Return a note as comment lines; control characters of a vendor's names stay out."""
    clean = "".join(c if c.isprintable() else " " for c in note)
    return textwrap.wrap(clean, _WIDTH, initial_indent="# - ", subsequent_indent="#   ")
