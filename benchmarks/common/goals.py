"""Goals of a benchmark: which figure is wanted, whether it is reached, and the table that shows it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from moc_opt.figures.notation import Doubtful, Notation
from moc_opt.report.tables import Column, Table
from moc_opt.study.statistics import Interval, spread


class Goal(NamedTuple):
    """Reached when the value, or the worse end of its interval, is at most, or at least, so much.

    Attributes:
        measured: the value in a summary, a number or an `Interval`; LookupError where it was not measured.
        made_of: in words, what the value was made of; also from a summary.
        section: of the page, with the figures around it.
    """

    what: str
    unit: str
    limit: float
    measured: Callable[[Any], Any]
    most: bool = True
    made_of: Callable[[Any], str] = lambda summary: ""
    section: str = ""


COLUMNS = [
    Column("what", "goal"),
    Column("wanted", "wanted"),
    Column("measured", "measured", sections="section"),
    Column("reached", "reached"),
    Column("made_of", "made of"),
]


def verdicts(summary: Mapping[str, Any], goals: Mapping[str, Goal]) -> dict[str, dict[str, Any]]:
    """Map goal to what, unit, goal, kind, value (None: not measured), made_of and reached.

    Reached is "yes", "no", "open" where the value's interval holds the limit or the value is not to be trusted, or
    "not measured". A time that other work on the machine lengthened, and that is short enough all the same, is.
    """
    found: dict[str, dict[str, Any]] = {}
    for key, goal in goals.items():
        verdict: dict[str, Any] = {"value": None, "reached": "not measured", "made_of": ""}
        try:
            verdict = {"made_of": "", **_verdict(goal, goal.measured(summary))}
            verdict["made_of"] = goal.made_of(summary)
        except (LookupError, ValueError):  # a part that did not run has no entries, and no largest of them
            pass
        kind = "at most" if goal.most else "at least"
        found[key] = {"what": goal.what, "unit": goal.unit, "goal": goal.limit, "kind": kind, **verdict}
    return found


def _verdict(goal: Goal, measured: Any) -> dict[str, Any]:
    if isinstance(measured, Doubtful):
        met = goal.most and goal.unit and measured <= goal.limit
        return {"value": measured, "reached": "yes" if met else "open"}
    if not isinstance(measured, Interval):
        measured = Interval(float(measured), float(measured), float(measured), 1)
    within = [end <= goal.limit if goal.most else end >= goal.limit for end in (measured.low, measured.high)]
    found = {"value": measured.value, "reached": "yes" if all(within) else "open" if any(within) else "no"}
    return found if measured.low == measured.high else found | measured.entries("value")


def goal_table(found: Mapping[str, Mapping[str, Any]], goals: Mapping[str, Goal]) -> Table:
    """Make the table of what `verdicts` found."""
    rows = [
        {
            "what": row["what"], "wanted": f"{row['kind']} {row['goal']:.3g} {row['unit']}".strip(),
            "measured": value_text(row), "reached": row["reached"], "made_of": row["made_of"] or None,
            "section": goals[key].section,
        } for key, row in found.items()
    ]  # fmt: skip
    shown = COLUMNS if any(row["made_of"] for row in rows) else COLUMNS[:-1]
    return Table("Goals", shown, rows)


def value_text(row: Mapping[str, Any]) -> str | None:
    """Write a goal's value with its interval or doubt, and its unit; None where it was not measured."""
    value = row["value"]
    if value is None:
        return None
    doubt = "?" * isinstance(value, Doubtful)
    text = spread(row, "value") if "value_low" in row else doubt + Notation.of([value])(value)
    return f"{text} {row['unit']}".strip()


def goals_in_words(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Say how many goals are reached, and which are not."""
    words = [row["reached"] for row in found.values()]
    text = f"{words.count('yes')} of {len(words)} goals are reached"
    text += "".join(f", {words.count(word)} {word}" for word in ("open", "not measured") if word in words)
    missed = [f"{row['what']} ({value_text(row)})" for row in found.values() if row["reached"] == "no"]
    return text + (f"; missed: {'; '.join(missed)}." if missed else ".")
