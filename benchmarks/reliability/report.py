"""Tables, the page and docs/reliability.md of the fault benchmark."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.common.answer import Answer, Picture, goals_answer, interval_picture
from benchmarks.reliability.summary import Summary, outcome
from moc_opt import figures
from moc_opt.figures.notation import Notation
from moc_opt.figures.style import GOOD
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.trace.trace import Trace

CASES = [
    Column("case", "fault"),
    Column("solver", "controller"),
    Column("outcome", "outcome", help="of the trials: survived within the limits, or stopped safely"),
    Column("tip_error_max_mm", "worst tip", unit="mm", format=".2f", help="until the stop, where there was one"),
    Column("rcm_error_max_mm", "worst RCM", unit="mm", format=".2f", help="the stop included"),
    Column("trocar_force_max_N", "worst force", unit="N", format=".2f"),
    Column("rcm_mean_percent", "mean RCM", unit="%", format="+.1f", help="above the same run without the fault"),
    Column(
        "recover_s", "recovered after", unit="s", format=".2f",
        help="from the fault's end, or its start where it lasts: both errors below 1.2 times the fault-free level for "
        "good; a dash: not within the run",
    ),
    Column("stop_travel_mm", "stop travel", unit="mm", format=".1f", help="of the tip after the stop began"),
]  # fmt: skip
SEEN = [
    Column("case", "fault"),
    Column("solver", "controller"),
    Column("injected", "injected", format=".0f"),
    Column("detected", "detected", format=".0f"),
    Column("harmless", "harmless", format=".0f", help="corrupted, taken, and verified as optimal all the same"),
    Column("missed", "missed", format=".0f"),
    Column("false_alarms", "false alarms", format=".0f", help="honest answers that were refused"),
]
EVERY, SOLVERS = "Every fault", "Solver faults"
GOALS = [
    Column("goal", "goal"),
    Column("limit", "limit", align="right"),
    Column("value", "found", align="right", sections="explained"),
    Column("reached", "reached"),
    Column("where", "where", section=EVERY),
]


PICTURED = {
    "rcm_error_max_mm": ("Largest RCM error", "mm"), "trocar_force_max_N": ("Largest force on the trocar", "N"),
}  # fmt: skip
"""Figure -> its words and unit."""


def case_rows(summary: Summary) -> list[dict[str, Any]]:
    """Return one row per case and controller."""
    return [
        {"case": case, "solver": name, **figures, "outcome": outcome(figures)}
        for case, by in summary.items()
        for name, figures in by.items()
    ]


def tables(summary: Summary, goals: list[dict[str, Any]]) -> list[Table]:
    """Make the tables: goals, every case, and what the supervisor saw."""
    rows = case_rows(summary)
    return [
        Table("Goals", GOALS, in_words(goals)),
        Table("Every fault under every controller: the worst of the trials", CASES, rows),
        Table(
            "Solver faults, injected and detected", SEEN, [r for r in rows if r["group"] == "solver"],
        ),
    ]  # fmt: skip


def headline(summary: Summary, goals: list[dict[str, Any]]) -> str:
    """Return the result in words, computed."""
    rows = case_rows(summary)
    runs = sum(r["runs"] for r in rows)
    survived, stopped = (sum(r[name] for r in rows) for name in ("survived", "stopped"))
    injected, detected, harmless = (sum(r.get(k, 0) for r in rows) for k in ("injected", "detected", "harmless"))
    text = (
        f"Of {runs} runs {survived} survived, {stopped} were stopped, and {runs - survived - stopped} did neither. "
        f"Of {injected} injected solver faults {detected} were detected"
    )
    if harmless:
        text += f"; {harmless} more had the optimum for an answer"
    missed = [goal["goal"] for goal in goals if not goal["reached"]]
    return text + ". " + (f"Not reached: {'; '.join(missed)}." if missed else "Every goal is reached.")


def answer(summary: Summary, goals: list[dict[str, Any]], traces: Mapping[str, Trace]) -> Answer:
    """Make the first screen out of the summary, the goals and the traces of one trial."""
    pictures = [
        Picture(
            figures.time_series(traces, ("tip_error_m", "rcm_error_m", "trocar_force_N")),
            "MOC with exact, first trial: errors and trocar force come back after a fault, or the arm has stopped.",
            "faults",
        )
    ] if traces else []  # fmt: skip
    pictures += [_worst(summary, key, unit, what) for key, (what, unit) in PICTURED.items()]
    return goals_answer(headline(summary, goals), "Goals", GOALS, in_words(goals), pictures)


def in_words(goals: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Write limits and figures each for itself, of quantities that have nothing in common, with their sections."""
    return [
        {**goal, "limit": f"{goal['limit']:g}", "value": Notation.of([goal["value"]])(goal["value"]),
         "explained": SOLVERS if "refused" in goal["goal"] or "noticed" in goal["goal"] else EVERY}
        for goal in goals
    ]  # fmt: skip


def _worst(summary: Summary, key: str, unit: str, what: str) -> Picture:
    """Draw a figure's least, middle and largest value over the cases and controllers of every group of faults."""
    groups = {
        group: sorted((row[key], f"{row['case']} under {row['solver']}") for row in rows if key in row)
        for group, rows in by_group(summary).items()
    }
    found = {group: values for group, values in groups.items() if values}
    ends = {group: tuple(values[at][0] for at in (0, len(values) // 2, -1)) for group, values in found.items()}
    value, where = max((values[-1] for values in found.values()), default=(0.0, "none"))
    says = f"{what} of a run, for each group of faults from the mildest case to the worst: at most {value:.3g} {unit}"
    drawn = interval_picture(ends, dict.fromkeys(ends, GOOD), f"{what[0].lower()}{what[1:]} [{unit}]", {})  # type: ignore[arg-type]
    return Picture(drawn, f"{says}, {where}.", f"worst-{key.partition('_')[0]}")


def report(summary: Summary, goals: list[dict[str, Any]], first: Answer, environment: Mapping[str, Any]) -> Page:
    """Make the page out of the summary, the goals and its first screen."""
    page = Page("Faults", "every fault under every controller: survived, or stopped safely")
    first.begin(page)
    _, cases, seen = tables(summary, goals)
    page.section(EVERY)
    page.table(cases)
    page.section(SOLVERS)
    page.table(seen)
    page.environment(environment)
    return page


def by_group(summary: Summary) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of the cases, group by group."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in case_rows(summary):
        groups.setdefault(str(row["group"]), []).append(row)
    return groups
