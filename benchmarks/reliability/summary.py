"""From rows to what was asked: survived or stopped, how bad, how soon over, all seen? And the goals, computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmarks.reliability.config import Config

OUTCOMES = ("survived", "stopped", "oscillated", "diverged", "ran away", "refused")
WORST = (
    "tip_error_max_mm", "rcm_error_max_mm", "trocar_force_max_N", "rcm_mean_percent", "rcm_max_percent",
    "stop_travel_mm", "last_speed_rad_per_s", "limited_ticks",
)  # fmt: skip
COUNTS = ("injected", "detected", "harmless", "missed", "false_alarms", "ticks")

AT_REST_RAD_PER_S = 0.05
RCM_LIMIT_PERCENT = 5.0
FALSE_ALARMS_PERCENT = 1.0

Row = Mapping[str, Any]
Summary = dict[str, dict[str, Any]]


def summarise(rows: Sequence[Row]) -> Summary:
    """Map case and controller to figures: outcomes counted over the trials, worst errors, faults summed."""
    found: Summary = {}
    for row in rows:
        found.setdefault(str(row["case"]), {}).setdefault(str(row["solver"]), []).append(row)
    return {case: {name: _worst(mine) for name, mine in by.items()} for case, by in found.items()}


def _worst(rows: Sequence[Row]) -> dict[str, Any]:
    figures: dict[str, Any] = {"group": rows[0]["group"], "runs": len(rows)}
    figures |= {name.replace(" ", "_"): sum(r["outcome"] == name for r in rows) for name in OUTCOMES}
    figures["ended"] = "; ".join(sorted({str(r["ended"]) for r in rows}))
    for name in WORST:
        values = [r[name] for r in rows if r.get(name) is not None]
        if values:
            figures[name] = max(values)
    for name in COUNTS:
        values = [r[name] for r in rows if r.get(name) is not None]
        if values:
            figures[name] = sum(values)
    times = [r.get("recover_s") for r in rows]
    figures["recovered"] = sum(t is not None for t in times)
    if None not in times:
        figures["recover_s"] = max(times)  # type: ignore[type-var]
    return figures


def outcome(figures: Row) -> str:
    """Say it in a word, or several where the trials differ."""
    parts = [(name, figures.get(name.replace(" ", "_"), 0)) for name in OUTCOMES]
    there = [(name, count) for name, count in parts if count]
    return there[0][0] if len(there) == 1 else ", ".join(f"{count} {name}" for name, count in there)


def goals(config: Config, summary: Summary) -> list[dict[str, Any]]:
    """Return each goal, the figure found, and whether it is reached; cases that were not run are left out."""
    everything = [(case, name, f) for case, by in summary.items() for name, f in by.items()]
    solver = {name: case for name, case in config.cases.items() if case.group == "solver"}
    always = {name for name, case in solver.items() if case.faults.get("solver_share", 0.0) >= 1.0}

    def total(key: str) -> float:
        return float(sum(f.get(key, 0) for _, _, f in everything))

    def largest(key: str, keep: Callable[[str], bool]) -> tuple[float | None, str]:
        values = [(f[key], f"{case}, {name}") for case, name, f in everything if keep(case) and key in f]
        return max(values, default=(None, ""))

    def row(text: str, limit: float, value: float | None, where: str = "") -> dict[str, Any]:
        reached = value is not None and value <= limit
        return {"goal": text, "limit": limit, "value": value, "where": where, "reached": reached}

    stops = [(f["last_speed_rad_per_s"], f"{c}, {n}") for c, n, f in everything if f["stopped"]]
    speed, slowest = max(stops, default=(0.0, ""))
    found = [
        row(
            "runs that diverge without saying so", 0, total("diverged"),
            "; ".join(f"{c}, {n}" for c, n, f in everything if f["diverged"]),
        ),
        row("runs that the plant could not go on with", 0, total("ran_away") + total("refused")),
        row("injected solver faults that were not noticed", 0, total("missed")),
        row(
            "honest answers refused [percent of all ticks]", FALSE_ALARMS_PERCENT,
            100.0 * total("false_alarms") / max(total("ticks"), 1.0),
        ),
        row(
            "mean RCM error above the fault-free run, solver faulty now and then [percent]", RCM_LIMIT_PERCENT,
            *largest("rcm_mean_percent", lambda case: case in solver and case not in always),
        ),
        row(
            "largest RCM error above the fault-free run, solver faulty now and then [percent]", RCM_LIMIT_PERCENT,
            *largest("rcm_max_percent", lambda case: case in solver and case not in always),
        ),
        row(
            "mean RCM error above the fault-free run, solver faulty at every tick [percent]", RCM_LIMIT_PERCENT,
            *largest("rcm_mean_percent", lambda case: case in always),
        ),
        row("speed of any joint at the end of a stop [rad/s]", AT_REST_RAD_PER_S, speed, slowest),
    ]  # fmt: skip
    return [goal for goal in found if goal["value"] is not None]
