"""From rows to what was asked: survived or stopped, how bad, how soon over, all seen? And the goals, computed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from benchmarks.reliability.runs import Case

OUTCOMES = ("survived", "stopped", "oscillated", "diverged", "ran away", "refused")
WORST = (
    "tip_error_max_mm", "rcm_error_max_mm", "trocar_force_max_N", "rcm_mean_percent", "rcm_max_percent",
    "stop_travel_mm", "last_speed_rad_per_s",
)  # fmt: skip
COUNTS = ("injected", "detected", "harmless", "missed", "false_alarms", "ticks")

AT_REST_RAD_PER_S = 0.05
RCM_LIMIT_PERCENT = 5.0
FALSE_ALARMS_PERCENT = 1.0

Row = Mapping[str, Any]
Summary = Mapping[str, Mapping[str, Row]]


def summarise(rows: Sequence[Row]) -> dict[str, dict[str, dict[str, Any]]]:
    """Map case and controller to figures: outcomes counted over the trials, worst errors, faults summed."""
    found: dict[str, dict[str, list[Row]]] = {}
    for row in rows:
        found.setdefault(str(row["case"]), {}).setdefault(str(row["solver"]), []).append(row)
    return {case: {name: _worst(mine) for name, mine in by.items()} for case, by in found.items()}


def _worst(rows: Sequence[Row]) -> dict[str, Any]:
    figures: dict[str, Any] = {"group": rows[0]["group"], "runs": len(rows)}
    figures |= {name.replace(" ", "_"): sum(r["outcome"] == name for r in rows) for name in OUTCOMES}
    figures["ended"] = "; ".join(sorted({str(r["ended"]) for r in rows}))
    for names, combine in ((WORST, max), (COUNTS, sum)):
        for name in names:
            if values := [r[name] for r in rows if r.get(name) is not None]:
                figures[name] = combine(values)
    times = [r["recover_s"] for r in rows if r.get("recover_s") is not None]
    figures["recovered"] = len(times)
    if len(times) == len(rows):
        figures["recover_s"] = max(times)
    return figures


def outcome(figures: Row) -> str:
    """Say it in a word, or several where the trials differ."""
    there = {name: count for name in OUTCOMES if (count := figures.get(name.replace(" ", "_"), 0))}
    return next(iter(there)) if len(there) == 1 else ", ".join(f"{count} {name}" for name, count in there.items())


def case_rows(summary: Summary) -> list[dict[str, Any]]:
    """Return one row per case and controller."""
    return [
        {"case": case, "solver": name, **figures, "outcome": outcome(figures)}
        for case, by in summary.items() for name, figures in by.items()
    ]  # fmt: skip


def goals(cases: Mapping[str, Case], summary: Summary) -> list[dict[str, Any]]:
    """Return each goal, the figure found, and whether it is reached; cases that were not run are left out."""
    everything = case_rows(summary)
    solver = {name: case for name, case in cases.items() if case.group == "solver"}
    always = {name for name, case in solver.items() if case.faults.get("solver_share", 0.0) >= 1.0}
    seldom = set(solver) - always

    def total(key: str) -> float:
        return float(sum(row.get(key, 0) for row in everything))

    def largest(key: str, among: Collection[str]) -> tuple[float | None, str]:
        values = [(r[key], f"{r['case']}, {r['solver']}") for r in everything if r["case"] in among and key in r]
        return max(values, default=(None, ""))

    stops = [(r["last_speed_rad_per_s"], f"{r['case']}, {r['solver']}") for r in everything if r["stopped"]]
    diverged = "; ".join(f"{r['case']}, {r['solver']}" for r in everything if r["diverged"])
    asked: list[tuple[str, float, float | None, str]] = [
        ("runs that diverge without saying so", 0, total("diverged"), diverged),
        ("runs that the plant could not go on with", 0, total("ran_away") + total("refused"), ""),
        ("injected solver faults that were not noticed", 0, total("missed"), ""),
        ("honest answers refused [percent of all ticks]", FALSE_ALARMS_PERCENT,
         100.0 * total("false_alarms") / max(total("ticks"), 1.0), ""),
        ("mean RCM error above the fault-free run, solver faulty now and then [percent]", RCM_LIMIT_PERCENT,
         *largest("rcm_mean_percent", seldom)),
        ("largest RCM error above the fault-free run, solver faulty now and then [percent]", RCM_LIMIT_PERCENT,
         *largest("rcm_max_percent", seldom)),
        ("mean RCM error above the fault-free run, solver faulty at every tick [percent]", RCM_LIMIT_PERCENT,
         *largest("rcm_mean_percent", always)),
        ("speed of any joint at the end of a stop [rad/s]", AT_REST_RAD_PER_S, *max(stops, default=(0.0, ""))),
    ]  # fmt: skip
    return [
        {"goal": goal, "limit": limit, "value": value, "where": where, "reached": value <= limit}
        for goal, limit, value, where in asked if value is not None
    ]  # fmt: skip


def headline(summary: Summary, goals: Sequence[Row]) -> str:
    """Return the result in words, computed."""
    rows = case_rows(summary)
    runs, survived, stopped, injected, detected, harmless = (
        sum(r.get(key, 0) for r in rows)
        for key in ("runs", "survived", "stopped", "injected", "detected", "harmless")
    )
    text = (
        f"Of {runs} runs {survived} survived, {stopped} were stopped, and {runs - survived - stopped} did neither. "
        f"Of {injected} injected solver faults {detected} were detected"
    )
    if harmless:
        text += f"; {harmless} more had the optimum for an answer"
    missed = [goal["goal"] for goal in goals if not goal["reached"]]
    return text + ". " + (f"Not reached: {'; '.join(missed)}." if missed else "Every goal is reached.")
