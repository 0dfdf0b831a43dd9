"""From rows to figures with their intervals, to goals, and to what is said of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.planning.runs import ERRORS
from moc_opt.study.statistics import StatisticsError, mean, relative_change, spread, too_few

Row = Mapping[str, Any]
Rows = Sequence[Row]

LOCAL = "local"
MOST_GAP_PERCENT: Mapping[str, float] = {LOCAL: 2.0, "receding": 1.0, "planned": 0.5}
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
TRAPPED_PERCENT = 5.0
"""A run that ends further below the best course from its start is trapped: as a rule at a lower local maximum of mu."""
MEANS = (
    "from_start", "best", "climb_gap_percent", "start_loss_percent", "bound_gap_percent", "refined_percent",
    "halving_percent", "map_s", "search_s", "refine_s", "scratch_s",
)  # fmt: skip


def summarise(rows: Rows) -> dict[str, Any]:
    """Return part -> robot (or "robot, trial") -> figures; trials that failed are counted."""
    summary: dict[str, Any] = {"courses": {}, "loops": {}, "closed_form": {}, "restarts": {}}
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        runs = [row for row in mine if row["part"] == "loop"]
        summary["courses"][robot] = _courses([row for row in mine if row["part"] in ("courses", "halving")])
        summary["loops"][robot] = {name: _loop(runs, name) for name in dict.fromkeys(row["loop"] for row in runs)}
        for row in mine:
            if row["part"] in ("closed_form", "restarts"):
                about = ("part", "robot", "task", "trial", "seed")
                figures = {key: value for key, value in row.items() if key not in about}
                summary[row["part"]][f"{robot}, {row['trial']}"] = figures
    summary["goals"] = goal_rows(summary)
    return summary


def _loop(runs: Rows, name: str) -> dict[str, Any]:
    """Return means over the whole runs of one third level; changes against "local" on the trials that both ended."""
    mine = [row for row in runs if row["loop"] == name]
    whole = {row["trial"]: row for row in mine if not row["error"]}
    found: dict[str, Any] = {"runs": len(mine), "broken": len(mine) - len(whole)}
    if not whole:
        return found
    gaps = [row["gap_percent"] for row in whole.values()]
    found |= {"gap_percent_median": float(np.median(gaps)), "gap_over_5": sum(gap > TRAPPED_PERCENT for gap in gaps)}
    found["left_course"] = sum(row.get("left_course_s") is not None for row in whole.values())
    for key in ("gap_percent", "fraction_of_best", *ERRORS, "course_gap_percent", "replan_ms_p99"):
        values = [row[key] for row in whole.values() if row.get(key) is not None]
        if values:
            found |= mean(values).entries(key) | {f"{key}_max": max(values)}
    base = {row["trial"]: row for row in runs if row["loop"] == LOCAL and not row["error"]}
    both = [(whole[trial], base[trial]) for trial in whole if trial in base]
    for key in ERRORS if both and name != LOCAL else ():
        change = relative_change(*zip(*[(a[key], b[key]) for a, b in both], strict=True))
        found |= change.entries(f"{key}_change_percent")
    return found


def _courses(rows: Rows) -> dict[str, Any]:
    trials = [row for row in rows if row["part"] == "courses"]
    found: dict[str, Any] = {"trials": len(trials), "failed": sum(bool(row["error"]) for row in trials)}
    rows = [{**row, **({"scratch_s": row["map_s"] + row["search_s"]} if "map_s" in row else {})} for row in rows]
    for name in ("executable", "climbed_whole", "certified"):
        found[name] = sum(bool(row.get(name)) for row in rows)
    for name in MEANS:
        values = [row[name] for row in rows if name in row]
        if values:
            found |= mean(values).entries(name) | {f"{name}_max": max(values)}
            found[f"{name}_abs_max"] = float(np.abs(values).max())
    found["violation_max"] = max((row["violation"] for row in rows if "violation" in row), default=None)
    found["unbounded"] = sum("best" in row and "bound_gap_best_percent" not in row for row in trials)
    found["climb_gap_over_5"] = sum(row.get("climb_gap_percent", 0.0) > TRAPPED_PERCENT for row in rows)
    return found


def goal_rows(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return one row a robot and goal: "met" or "missed" by both ends of its interval, else "open"; "not measured"."""
    rows = []
    for robot, figures in summary["courses"].items():
        loops = summary["loops"].get(robot, {})
        trials = max((int(loop.get("runs", 0)) for loop in loops.values()), default=0)
        above = [row["above_map"] for name, row in summary["closed_form"].items() if name.startswith(f"{robot},")
                 and "above_map" in row]  # fmt: skip
        best = {"above": max(above)} if above else {}
        for goal, limit, found, key in (
            *((f"{name}: mean gap to the best course [%]", most, loops.get(name, {}), "gap_percent")
              for name, most in MOST_GAP_PERCENT.items()),
            ("planned: largest gap [%]", MOST_PLANNED_PERCENT, loops.get("planned", {}), "gap_percent_max"),
            *((f"{name}: {what} error against local's [%]", MOST_CHANGE_PERCENT, loops.get(name, {}),
               f"{error}_change_percent")
              for name in ("planned", "receding") for what, error in zip(("tip", "RCM"), ERRORS, strict=True)),
            ("receding: a solve, p99 of the worst run [ms]", MOST_REPLAN_MS, loops.get("receding", {}),
             "replan_ms_p99_max"),
            ("map and search from scratch, at worst [s]", MOST_SCRATCH_S, figures, "scratch_s_max"),
            ("halving the grid moves it by [%]", MOST_HALVING_PERCENT, figures, "halving_percent_abs_max"),
            ("largest mu above the map's by random starts [m^3]", MOST_ABOVE_MAP, best, "above"),
        ):  # fmt: skip
            verdict = judged(found, key, limit, trials)
            value = spread(found, key) or "-"
            rows.append({"robot": robot, "goal": goal, "limit": limit, "value": value, "verdict": verdict})
    return rows


def judged(found: Row, key: str, limit: float, trials: int) -> str:
    """Judge a figure by both ends of its interval; of no trials is what is no mean over them."""
    low, high = (found.get(f"{key}_{end}", found.get(key)) for end in ("low", "high"))
    if low is None or high is None:
        return "not measured"
    if trials and (few := too_few(trials)):
        return few
    return "met" if high <= limit else "missed" if low > limit else "open"


def sentences(summary: Mapping[str, Any], runs: Rows) -> Iterator[str]:
    """Say what each third level leaves, where the local one is trapped and by how much, and which goals are met."""
    gaps: dict[str, list[float]] = {}
    for row in runs:
        gaps.setdefault(row["loop"], []).append(row["gap_percent"])
    said = [f"`{name}` {_mean(mine)} % ({max(mine):.1f} at worst, {len(mine)} runs)" for name, mine in gaps.items()]
    yield f"In the loop mean mu ends below that of the best course from the same start by: {', '.join(said)}."
    local = sorted((row for row in runs if row["loop"] == LOCAL), key=lambda row: -float(row["gap_percent"]))
    trapped = [row for row in local if row["gap_percent"] > TRAPPED_PERCENT]
    if local:
        where = ", ".join(f"{row['robot']} {row['trial']} ({row['gap_percent']:.0f} %)" for row in trapped[:4])
        yield (
            f"Climbing mu locally is trapped (more than {TRAPPED_PERCENT:g} % below) at {len(trapped)} of {len(local)} "
            f"starts{': the worst are ' + where if trapped else ''}; elsewhere it leaves "
            f"{_mean([row['gap_percent'] for row in local[len(trapped) :]])} %."
        )
    goals, met = summary["goals"], sum(goal["verdict"] == "met" for goal in summary["goals"])
    missed = [f"{goal['robot']}: {goal['goal']} {goal['value']}" for goal in goals if goal["verdict"] == "missed"]
    yield (
        f"Of {len(goals)} goals {met} are met, {len(goals) - met - len(missed)} open, not measured or of too few "
        f"trials, and {len(missed)} missed{', the first: ' + '; '.join(missed[:3]) if missed else ''}."
    )


def _mean(values: Sequence[float]) -> str:
    try:
        found = mean(values)
    except StatisticsError:
        return "–"
    return f"{found.value:.2f}" if found.low != found.low else f"{found:.2f}"
