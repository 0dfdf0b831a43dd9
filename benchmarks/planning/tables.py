"""The planning benchmark's summary, tables and page, all from its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.common.answer import Answer
from benchmarks.common.output import close_page
from benchmarks.planning.first_screen import COURSES as COURSES_SECTION
from benchmarks.planning.first_screen import IN_THE_LOOP
from benchmarks.planning.goals import GOALS, goal_rows
from benchmarks.planning.parts import ERRORS
from moc_opt.comparison.statistics import mean, relative_change, spread
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

Rows = Sequence[Mapping[str, Any]]

MEANS = (
    "from_start", "best", "climbed", "climb_gap_percent", "start_loss_percent", "bound_gap_percent",
    "bound_gap_best_percent", "refined_percent", "halving_percent", "map_s", "search_s", "refine_s", "scratch_s",
)  # fmt: skip
LOOPS = [
    Column("robot", "robot"), Column("loop", "third level"), Column("runs", "runs", format="d"),
    Column("broken", "broke off", format="d"), Column("gap", "below best from start", unit="%"),
    Column("gap_percent_median", "median", unit="%", format=".2f"),
    Column("gap_percent_max", "at worst", unit="%", format=".1f"), Column("gap_over_5", "over 5 %", format="d"),
    Column("course", "its course below best", unit="%"), Column("left_course", "left it", format="d"),
    Column("fraction_of_best", "of best over all", format=".3f"),
    Column("tip", "tip", unit="mm", format=".3f"), Column("rcm", "RCM", unit="mm", format=".3f"),
    Column("tip_change", "tip, to local", unit="%"), Column("rcm_change", "RCM, to local", unit="%"),
]  # fmt: skip
COURSES = [
    Column("robot", "robot"), Column("trials", "trials", format="d"),
    Column("executable", "can be executed", format="d"), Column("climbed_whole", "climb arrives", format="d"),
    Column("from_start", "mu, best from start", unit="m^3", format=".4f"),
    Column("best", "mu, best over all", unit="m^3", format=".4f"),
    Column("climb_gap_percent", "climb below best from start", unit="%", format=".2f"),
    Column("climb_gap_percent_max", "at worst", unit="%", format=".1f"),
    Column("start_loss_percent", "start below best", unit="%", format=".2f"),
    Column("start_loss_percent_max", "at worst", unit="%", format=".1f"),
    Column("climb_gap_over_5", "climbs over 5 % below", format="d"),
]  # fmt: skip
TRUST = [
    Column("robot", "robot"), Column("certified", "local optima", format="d"),
    Column("violation_max", "largest violation", unit="m, rad", format=".0e"),
    Column("bound_gap_percent", "bound above course", unit="%", format=".3f"),
    Column("bound_gap_percent_max", "at worst", unit="%", format=".2f"),
    Column("unbounded", "best above its bound", format="d"),
    Column("refined_percent", "refinement gains", unit="%", format=".3f"),
    Column("halving_percent_abs_max", "halving the grid moves it by", unit="%", format=".3f"),
    Column("map_s", "map", unit="s", format=".2f"),
    Column("search_s", "search", unit="s", format=".2f"), Column("search_s_max", "at worst", unit="s", format=".2f"),
    Column("refine_s", "refinement", unit="s", format=".2f"),
]  # fmt: skip
CLOSED_FORM = [
    Column("name", "trial"), Column("starts", "random starts", format="d"), Column("placed", "poses found", format="d"),
    Column("map_mu", "largest mu of the map", unit="m^3", format=".8f"),
    Column("random_mu", "found at random", unit="m^3", format=".8f"),
    Column("above_map", "difference", unit="m^3", format=".1e"),
]  # fmt: skip
RESTARTS = [
    Column("name", "trial"), Column("restarts", "other starts", format="d"),
    Column("own", "plan", unit="m^3", format=".5f"),
    Column("as_good", "end as good", format="d"),
    Column("above_own_percent", "best of them above the plan", unit="%", format=".1e"),
]  # fmt: skip


def summarise(rows: Rows) -> dict[str, Any]:
    """Return part -> robot (or "robot, trial") -> figures; trials that failed are counted."""
    summary: dict[str, Any] = {"courses": {}, "loops": {}, "closed_form": {}, "restarts": {}, "map": {}}
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        planned = [row for row in mine if row["part"] in ("courses", "halving")]
        summary["courses"][robot] = _courses(planned)
        runs = [row for row in mine if row["part"] == "loop"]
        names = dict.fromkeys(row["loop"] for row in runs)
        summary["loops"][robot] = {name: _loop(runs, name) for name in names}
        for row in mine:
            if row["part"] in ("closed_form", "restarts", "map"):
                about = ("part", "robot", "task", "trial", "seed")
                name = robot if row["part"] == "map" else f"{robot}, {row['trial']}"
                summary[row["part"]][name] = {key: value for key, value in row.items() if key not in about}
    summary["goals"] = goal_rows(summary)
    return summary


def _loop(runs: Rows, name: str) -> dict[str, Any]:
    """Return means over the whole runs of one third level; changes against "local" on the trials that both ended."""
    mine = {row["trial"]: row for row in runs if row["loop"] == name}
    whole = {trial: row for trial, row in mine.items() if not row["error"]}
    found: dict[str, Any] = {"runs": len(mine), "broken": len(mine) - len(whole)}
    if not whole:
        return found
    gaps = [row["gap_percent"] for row in whole.values()]
    found |= mean(gaps).entries("gap_percent")
    found |= {"gap_percent_median": float(np.median(gaps)), "gap_percent_max": max(gaps)}
    found |= {"gap_over_5": sum(gap > 5.0 for gap in gaps)}
    for key in ("fraction_of_best", *ERRORS):
        found |= mean([row[key] for row in whole.values()]).entries(key)
    for key in ("course_gap_percent", "replan_ms_median", "replan_ms_p99"):
        values = [row[key] for row in whole.values() if row.get(key) is not None]
        if values:
            found |= mean(values).entries(key) | {f"{key}_max": max(values)}
    found["left_course"] = sum(row.get("left_course_s") is not None for row in whole.values())
    found["solve_p99_us"] = max((row["solve_p99_us"] or 0.0 for row in whole.values()), default=None)
    base = {row["trial"]: row for row in runs if row["loop"] == "local" and not row["error"]}
    both = [trial for trial in whole if trial in base]
    for key in ERRORS if both and name != "local" else ():
        change = relative_change([whole[trial][key] for trial in both], [base[trial][key] for trial in both])
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
    found["climb_gap_over_5"] = sum(row.get("climb_gap_percent", 0.0) > 5.0 for row in rows)
    return found


def tables(summary: Mapping[str, Any]) -> list[Table]:
    """Return what the courses are worth, how far they can be trusted, and the checks of map and program."""
    by_robot = [{"robot": robot, **figures} for robot, figures in summary["courses"].items()]
    made = [
        Table("Courses along the path, means over the trials", COURSES, by_robot),
        Table("How sure they are", TRUST, by_robot),
    ]
    loops = [
        {
            "robot": robot, "loop": name, **figures, "gap": spread(figures, "gap_percent"),
            "course": spread(figures, "course_gap_percent"),
            **{short: figures.get(key) for short, key in zip(("tip", "rcm"), ERRORS, strict=True)},
            **{f"{short}_change": spread(figures, f"{key}_change_percent", 2)
               for short, key in zip(("tip", "rcm"), ERRORS, strict=True)},
        } for robot, by in summary["loops"].items() for name, figures in by.items()
    ]  # fmt: skip
    if loops:
        made.insert(0, Table("In the loop, means over the whole runs with 95 % intervals", LOOPS, loops))
        made.insert(0, Table("Goals", GOALS, summary["goals"], "Met: the unfavourable end of the interval meets it."))
    for part, title, columns in (
        ("closed_form", "The map's largest mu against random inverse kinematics", CLOSED_FORM),
        ("restarts", "The nonlinear program begun elsewhere", RESTARTS),
    ):
        if summary[part]:
            made.append(Table(title, columns, [{"name": name, **row} for name, row in summary[part].items()]))
    timed = [{"name": name, **row} for name, row in summary["map"].items() if "map_s" in row]
    if timed:
        columns = [
            Column("name", "robot"), Column("poses", "poses", format="d"), Column("map_s", "best of 5", unit="s"),
            Column("map_median_s", "median", unit="s"),
        ]  # fmt: skip
        made.append(Table("Time of one map on one core", columns, timed))
    return made


def report(
    summary: Mapping[str, Any], rows: Rows, first: Answer, environment: Mapping[str, Any]
) -> Page:
    """Return one page that opens by itself: the first screen, and folded below it these tables."""
    page = Page("Planning over the redundancy", "the best course along a path, and what a local climb leaves")
    first.begin(page)
    page.section("How to read this")
    page.text(
        "Starts are drawn evenly from the joint ranges less a tenth at both ends, and rejected where the pose or one "
        "along the path is nearly singular, within 0.05 rad of a limit or below the base, or where kinematics alone "
        "cannot follow the task. Best from start and best over all starts are means of mu over the whole run, rests "
        "included, within joint limits and joint speeds. The climb follows the gradient of mu as fast as the joints "
        "can. In the loop the realistic plant is run at the configured settings, and its mean mu is compared with the "
        "best course from the same start; `its course below best` is what the followed course itself gives up for its "
        "margins, its braking and its smoothness. Tip and RCM errors are by the robot's own kinematics, from the "
        "registered trocar. The bound is of courses that the map resolves, and absent where one was found above it; "
        "times are from scratch, with as many processes as configured."
    )
    page.text(headline(summary))
    shown = tables(summary)
    loops = [table for table in shown if table.columns in (GOALS, LOOPS)]
    for title, made in ((IN_THE_LOOP, loops), (COURSES_SECTION, [table for table in shown if table not in loops])):
        page.section(title)
        for table in made:
            page.table(table)
    close_page(page, "plan", environment, rows, ("robot", "trial", "part"))
    return page


def headline(summary: Mapping[str, Any]) -> str:
    """Return one sentence a robot."""
    said = []
    for robot, row in summary["courses"].items():
        if "climb_gap_percent" in row:
            said.append(
                f"{robot}: a local climb ends {row['climb_gap_percent']:.2f} % below the best course from its start on "
                f"average and {row['climb_gap_percent_max']:.1f} % at worst; the start itself costs "
                f"{row['start_loss_percent']:.2f} % against the best over all."
            )
    return " ".join(said) or "No course was found."
