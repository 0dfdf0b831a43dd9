"""What the planning benchmark shows: its report, and the tables of docs/planning.md between their marks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.common import markdown
from benchmarks.common.answer import NO, UNKNOWN, YES, Answer, Picture
from benchmarks.common.output import close_page
from benchmarks.planning.runs import ERRORS
from benchmarks.planning.verdict import (
    LOCAL,
    MOST_CHANGE_PERCENT,
    MOST_GAP_PERCENT,
    TRAPPED_PERCENT,
    Row,
    Rows,
    judged,
    sentences,
)
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import Styles, figure, label, log_axis, rule
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.study.statistics import spread

Summary = Mapping[str, Any]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "planning.md"
COMMANDS: Mapping[str, str] = {
    "plan": "python -m benchmarks.plan --page",
    "plan-limits": "python -m benchmarks.plan benchmarks/configs/plan-limits.toml --page",
}
"""Configuration that ships, which is also its section of the page -> command. Of the second one the closed loops alone
are shown."""
LEAST_PERCENT = 0.01
"""Where a gap that is smaller, or none, is drawn on the log axis."""
IN_THE_LOOP, COURSES_SECTION = "In the loop", "Courses and checks"

FIRST = [
    Column("robot", "robot", section=COURSES_SECTION), Column("loop", "third level"),
    Column("runs", "runs", format="d", help="that came to their end"),
    Column("gap", "below best", unit="%", section=IN_THE_LOOP,
           help="mean mu below that of the best course from the same start"),
    Column("gap_percent_max", "worst", unit="%", format=".1f", section=IN_THE_LOOP),
    Column("gap_over_5", "trapped", format="d", section=IN_THE_LOOP, help="runs more than 5 % below"),
    Column("tip", "tip", unit="%", section=IN_THE_LOOP, help="change of the error against local's"),
    Column("rcm", "RCM", unit="%", section=IN_THE_LOOP, help="change of the error against local's"),
]  # fmt: skip
GOALS = [
    Column("robot", "robot"), Column("goal", "goal"), Column("limit", "limit", digits=3), Column("value", "value"),
    Column("verdict", "verdict"),
]  # fmt: skip
LOOPS = [
    Column("robot", "robot"), Column("loop", "third level"), Column("runs", "runs", format="d"),
    Column("broken", "broke off", format="d"), Column("gap", "below best from start", unit="%"),
    Column("gap_percent_median", "median", unit="%", format=".2f"),
    Column("gap_percent_max", "at worst", unit="%", format=".1f"), Column("gap_over_5", "over 5 %", format="d"),
    Column("course", "its course below best", unit="%"), Column("left_course", "left it", format="d"),
    Column("fraction_of_best", "of best over all", format=".3f"),
    Column(ERRORS[0], "tip", unit="mm", format=".3f"), Column(ERRORS[1], "RCM", unit="mm", format=".3f"),
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
    Column("own", "plan", unit="m^3", format=".5f"), Column("as_good", "end as good", format="d"),
    Column("above_own_percent", "best of them above the plan", unit="%", format=".1e"),
]  # fmt: skip


def answer(summary: Summary, rows: Rows) -> Answer:
    """Make the first screen out of the rows and their summary."""
    runs = [row for row in rows if row["part"] == "loop" and not row["error"]]
    shown = [
        {"robot": robot, "loop": name, **found, "runs": found["runs"] - found["broken"],
         "gap": _mark(found, "gap_percent", MOST_GAP_PERCENT.get(name), ".2f"),
         **{short: _mark(found, f"{key}_change_percent", MOST_CHANGE_PERCENT, "+.1f")
            for short, key in zip(("tip", "rcm"), ERRORS, strict=True)}}
        for robot, by in summary["loops"].items() for name, found in by.items()
    ]  # fmt: skip
    about = "✔ the goal is met by the unfavourable end of the interval, ✘ missed by all of it, – open."
    table = Table("How far each third level ends below the best course", FIRST, shown, about)
    if not runs:
        return Answer(["No run came to its end: see the errors below."], table)
    return Answer(list(sentences(summary, runs)), table, [_picture(runs)])


def _mark(found: Row, key: str, limit: float | None, spec: str) -> Mark | None:
    if found.get(key) is None:
        return None
    verdict = "open" if limit is None else judged(found, key, limit, found["runs"])
    known = {"met": YES, "missed": NO}.get(verdict, UNKNOWN)
    return Mark(known.symbol, format(found[key], spec), known.tone, known.rank)


def _picture(runs: Rows) -> Picture:
    """Draw the gap of every run, the starts that are worst for the local law first."""
    names = list(dict.fromkeys(row["loop"] for row in runs))
    starts: dict[tuple[str, str], dict[str, float]] = {}
    for row in runs:
        starts.setdefault((row["robot"], row["trial"]), {})[row["loop"]] = row["gap_percent"]
    order = sorted(starts, key=lambda key: -starts[key].get(LOCAL, 0.0))
    drawn, styles = figure(legend_y=1.08, height=340), Styles(names)
    for name in names:
        known = [(place, key, starts[key][name]) for place, key in enumerate(order, 1) if name in starts[key]]
        drawn.add_scatter(
            x=[place for place, *_ in known], y=[max(gap, LEAST_PERCENT) for *_, gap in known], mode="markers",
            name=label(name), customdata=[label(f"{robot} {trial}: {gap:.2f} %") for _, (robot, trial), gap in known],
            marker={"color": styles[name].color, "symbol": styles[name].symbol, "size": 7},
            hovertemplate="%{customdata}<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    log_axis(drawn, "y", "below the best course [%]", [LEAST_PERCENT, max(row["gap_percent"] for row in runs)])
    rule(drawn, "y", TRAPPED_PERCENT, "trapped")
    drawn.update_xaxes(title_text="start, by what the local law leaves there")
    says = f"Every run, the starts that are worst for `{LOCAL}` first: the others should lie far below it."
    return Picture(drawn, says, "gaps")


def tables(summary: Summary) -> dict[str, Table]:
    """Return what the closed loops reach, what courses are worth, and how far map and program can be trusted."""
    by_robot = [{"robot": robot, **figures} for robot, figures in summary["courses"].items()]
    loops = [
        {"robot": robot, "loop": name, **figures, "gap": spread(figures, "gap_percent"),
         "course": spread(figures, "course_gap_percent"),
         **{f"{short}_change": spread(figures, f"{key}_change_percent", 2)
            for short, key in zip(("tip", "rcm"), ERRORS, strict=True)}}
        for robot, by in summary["loops"].items() for name, figures in by.items()
    ]  # fmt: skip
    checks = {
        part: [{"name": name, **row} for name, row in summary[part].items()] for part in ("closed_form", "restarts")
    }
    made = {
        "loops": Table("In the loop, means over the whole runs with 95 % intervals", LOOPS, loops),
        "courses": Table("Courses along the path, means over the trials", COURSES, by_robot),
        "trust": Table("How sure they are", TRUST, by_robot),
        "closed_form": Table(
            "The map's largest mu against random inverse kinematics", CLOSED_FORM, checks["closed_form"]
        ),
        "restarts": Table("The nonlinear program begun elsewhere", RESTARTS, checks["restarts"]),
    }
    return {name: table for name, table in made.items() if table.rows}


def report(summary: Summary, rows: Rows, first: Answer, environment: Mapping[str, Any]) -> Page:
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
    shown = tables(summary)
    page.section(IN_THE_LOOP)
    if "loops" in shown:
        page.table(Table("Goals", GOALS, summary["goals"], "Met: the unfavourable end of the interval meets it."))
        page.table(shown.pop("loops"))
    page.section(COURSES_SECTION)
    for table in shown.values():
        page.table(table)
    close_page(page, "plan", environment, rows, ("robot", "trial", "part"))
    return page


def page_text(section: str, summary: Summary, environment: Summary) -> str:
    """Return the text of a section of docs/planning.md, one of `COMMANDS`."""
    machine, config, shown = environment["machine"], environment["config"], tables(summary)
    trials = ", ".join(f"{robot} {found['trials']}" for robot, found in summary["courses"].items())
    where = f"{machine['cores']} cores, {machine['processor']}, {config['processes']} trials at a time"
    said = f"`{COMMANDS[section]}` (seed {environment['seed']}; poses: {trials}; {where}; means with 95 % intervals):"
    if section == "plan-limits":
        return "\n\n".join([said, markdown.of_columns(LOOPS, shown["loops"].rows)])
    goals: dict[tuple[str, float], dict[str, str]] = {}
    for row in summary["goals"]:
        cell = "not measured" if row["verdict"] == "not measured" else f"{row['value']}: {row['verdict']}"
        goals.setdefault((row["goal"], row["limit"]), {})[row["robot"]] = cell
    robots = list(summary["courses"])
    rows = [[goal, f"{limit:g}", *(cells.get(robot, "") for robot in robots)] for (goal, limit), cells in goals.items()]
    parts = [f"{table.title}:\n\n{markdown.of_columns(table.columns, table.rows)}" for table in shown.values()]
    return "\n\n".join([said, markdown.table(["goal", "at most", *robots], rows), *parts])
