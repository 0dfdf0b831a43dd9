"""Goals of the studies: limits for measured values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from moc_opt.figures.notation import Notation
from moc_opt.report.tables import Column, Table
from moc_opt.study.show import MARKS, OPEN
from moc_opt.study.statistics import Change, Interval, spread, too_few


class Goal(NamedTuple):
    """A limit for the value (number, `Interval` or `Change`) of ``measured``. Both ends of an interval must meet it."""

    what: str
    unit: str
    limit: float
    measured: Callable[[Any], Any]
    most: bool = True  #: True: the limit is the largest allowed value; False: the smallest
    made_of: Callable[[Any], str] = lambda summary: ""  #: the parts of the value, in words
    section: str = ""  #: section of the report that the value links to


def judge(summary: Mapping[str, Any], goals: Mapping[str, Goal]) -> dict[str, dict[str, Any]]:
    """Judge every goal. A goal is open if the value's interval contains the limit, or if there are too few trials."""
    found: dict[str, dict[str, Any]] = {}
    for key, goal in goals.items():
        row: dict[str, Any] = {
            "what": goal.what, "unit": goal.unit, "goal": goal.limit, "kind": "at most" if goal.most else "at least",
            "value": None, "reached": "not measured", "made_of": "", "section": goal.section,
        }  # fmt: skip
        with suppress(LookupError, ValueError):  # a part of the study did not run
            if (measured := goal.measured(summary)) is not None:
                row |= _reached(goal, measured) | {"made_of": goal.made_of(summary)}
        found[key] = row
    return found


def _reached(goal: Goal, measured: Any) -> dict[str, Any]:
    if not isinstance(measured, Interval | Change):
        measured = Interval(float(measured), float(measured), float(measured), 1)
    both = measured if isinstance(measured, Change) else [measured]
    one = both[0]
    within = [end <= goal.limit if goal.most else end >= goal.limit for by in both for end in (by.low, by.high)]
    reached = "yes" if all(within) else "open" if any(within) else "no"
    if (one.samples > 1 or one.low != one.high) and too_few(one.samples):
        reached = "open"
    found = {"value": one.value, "reached": reached}
    return found if one.low == one.high else found | measured.entries("value")


def goals_table(found: Mapping[str, Mapping[str, Any]], title: str = "Goals") -> Table:
    """Make a table of `judge`'s result, missed goals first."""
    rows = [
        {
            "what": row["what"], "wanted": f"{row['kind']} {row['goal']:.3g} {row['unit']}".strip(),
            "measured": value_text(row), "reached": MARKS.get(row["reached"], OPEN), "made_of": row["made_of"] or None,
            "section": row["section"],
        } for row in found.values()
    ]  # fmt: skip
    rows.sort(key=lambda row: -row["reached"].rank)  # type: ignore[attr-defined]
    shown = [
        Column("reached", ""), Column("what", "goal"), Column("wanted", "wanted"),
        Column("measured", "measured", sections="section"), Column("made_of", "details"),
    ]  # fmt: skip
    return Table(title, shown if any(row["made_of"] for row in rows) else shown[:-1], rows)


def value_text(row: Mapping[str, Any]) -> str | None:
    value = row["value"]
    if value is None:
        return None
    text = spread(row, "value") if "value_low" in row else Notation.of([value])(value)
    return f"{text} {row['unit']}".strip()


def goals_sentence(found: Mapping[str, Mapping[str, Any]]) -> str:
    words = [row["reached"] for row in found.values()]
    text = f"{words.count('yes')} of {len(words)} goals are reached"
    text += "".join(f", {words.count(word)} {word}" for word in ("open", "not measured") if word in words)
    missed = [f"{row['what']} = {value_text(row)}" for row in found.values() if row["reached"] == "no"]
    return text + (f". Missed: {'; '.join(missed)}." if missed else ".")
