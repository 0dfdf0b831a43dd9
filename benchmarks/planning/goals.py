"""The goals of the planning benchmark, and which of them are met: by the unfavourable end of every interval."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.planning.parts import ERRORS
from moc_opt.comparison.statistics import spread
from moc_opt.report.tables import Column

MOST_GAP_PERCENT: Mapping[str, float] = {"local": 2.0, "receding": 1.0, "planned": 0.5}
"""Mean of mu in the loop below the best course from the same start."""
MOST_PLANNED_PERCENT = 3.0
"""At any trial."""
MOST_CHANGE_PERCENT = 5.0
"""Of tip and RCM error, against those of the local law."""
MOST_SCRATCH_S = 3.0
MOST_REPLAN_MS = 20.0
"""Of `receding`, the 99th percentile of the solves of any run."""
MOST_ABOVE_MAP = 1e-6
MOST_HALVING_PERCENT = 0.5
GOALS = [
    Column("robot", "robot"), Column("goal", "goal"), Column("limit", "limit", digits=3), Column("value", "value"),
    Column("verdict", "verdict"),
]  # fmt: skip


def goal_rows(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return one row a robot and goal: "met", "missed", "open" where the interval holds the limit, "not measured"."""
    rows = []
    for robot, figures in summary["courses"].items():
        for goal, limit, found, name in _asked(robot, figures, summary):
            low, high = (found.get(f"{name}_{end}", found.get(name)) for end in ("low", "high"))
            rows.append({
                "robot": robot, "goal": goal, "limit": limit, "value": spread(found, name) or "-",
                "verdict": _verdict(low, high, limit),
            })  # fmt: skip
    return rows


def _verdict(low: float | None, high: float | None, limit: float) -> str:
    if low is None or high is None:
        return "not measured"
    if high <= limit:
        return "met"
    return "missed" if low > limit else "open"


def _asked(
    robot: str, figures: Mapping[str, Any], summary: Mapping[str, Any]
) -> list[tuple[str, float, Mapping[str, Any], str]]:
    """Return goal, limit, the figures it is judged by, and which of them."""
    loops = summary["loops"].get(robot, {})
    found: list[tuple[str, float, Mapping[str, Any], str]] = []
    for name, limit in MOST_GAP_PERCENT.items():
        found.append((f"{name}: mean gap to the best course [%]", limit, loops.get(name, {}), "gap_percent"))
    planned = loops.get("planned", {})
    found.append(("planned: largest gap [%]", MOST_PLANNED_PERCENT, planned, "gap_percent_max"))
    for name in ("planned", "receding"):
        for short, key in zip(("tip", "RCM"), ERRORS, strict=True):
            goal = f"{name}: {short} error against local's [%]"
            found.append((goal, MOST_CHANGE_PERCENT, loops.get(name, {}), f"{key}_change_percent"))
    replans = loops.get("receding", {})
    found.append(("receding: a solve, p99 of the worst run [ms]", MOST_REPLAN_MS, replans, "replan_ms_p99_max"))
    found.append(("map and search from scratch, at worst [s]", MOST_SCRATCH_S, figures, "scratch_s_max"))
    found.append(("halving the grid moves it by [%]", MOST_HALVING_PERCENT, figures, "halving_percent_abs_max"))
    above = [row["above_map"] for name, row in summary["closed_form"].items() if name.startswith(f"{robot},")
             and "above_map" in row]  # fmt: skip
    best = {"above": max(above)} if above else {}
    found.append(("largest mu above the map's by random starts [m^3]", MOST_ABOVE_MAP, best, "above"))
    return found
