"""The first screen of every report and of every benchmark's console: the answer, one table, a few pictures.

Everything else lies folded below, and is reached by links from the columns of the table; see `Column.section`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import plotly.graph_objects as go

from moc_opt.figures.notation import Mark, pretty_units
from moc_opt.figures.style import figure, label, log_axis, rule
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

MOST_COLUMNS = 8
YES, NO, UNKNOWN = Mark("✔", "yes", "good", 0), Mark("✘", "no", "bad", 2), Mark("–", "open", "other", 1)
"""Of what was to be reached or confirmed."""
WORDS = {
    "yes": YES, "no": NO, "met": Mark("✔", "met", "good", 0), "missed": Mark("✘", "missed", "bad", 2), "open": UNKNOWN,
    "not measured": Mark("–", "not measured", "other", 1),
}  # fmt: skip


class Picture(NamedTuple):
    """A figure, one sentence that says what to see in it, and the name of its file."""

    figure: go.Figure
    says: str
    name: str


@dataclass(frozen=True)
class Answer:
    """What a user came for.

    Attributes:
        sentences: up to three, the most important one first.
        table: of few columns, the most important ones first.
        pictures: up to three; made when the page is.
        note: below the table: what the machine did while times were taken; "" for nothing.
    """

    sentences: Sequence[str]
    table: Table
    pictures: Sequence[Picture] = ()
    note: str = ""

    def begin(self, page: Page) -> None:
        """Write it at the top of a page, and fold what comes after it."""
        for sentence in self.sentences:
            page.headline(sentence)
        page.table(self.table)
        if self.note:
            page.text(self.note)
        for picture in self.pictures:
            page.figure(picture.figure, picture.says, name=picture.name)
        page.fold()

    def screens(self, width: int) -> Iterator[object]:
        """Yield what a terminal of this width [characters] prints: sentences, and the table in as few parts as fit."""
        yield from self.sentences
        left = self.table
        if not left.columns[len(left.narrowed(width).columns) :]:
            yield left.narrowed(width)
            return
        left = replace(left, caption="")  # as wide as the terminal, not as the last part
        while rest := left.columns[len(left.narrowed(width).columns) :]:
            yield left.narrowed(width)
            left = replace(left, title=f"{self.table.title} (continued)", columns=[left.columns[0], *rest])
        yield left.narrowed(width)
        yield self.table.caption
        if self.note:
            yield self.note


def reached(value: object) -> Mark:
    """Mark a goal as reached, missed or not measured; takes a flag, "yes" or "no"."""
    return YES if value in (True, "yes") else NO if value in (False, "no") else UNKNOWN


def in_sentences(text: str, most: int = 3) -> list[str]:
    """Split a text at the ends of sentences; those beyond ``most`` stay with the last part."""
    parts = re.split(r"(?<=\.) (?=[A-Z`])", text)
    return [*parts[: most - 1], " ".join(parts[most - 1 :])] if len(parts) > most else parts


def marked_answer(text: str | Sequence[str], table: Table, pictures: Sequence[Picture] = ()) -> Answer:
    """Make the answer of a text or its sentences, a table and pictures.

    Of the table its first eight columns are taken, with its verdicts in colour and with a symbol.
    """
    columns = table.columns[:MOST_COLUMNS]
    rows = [
        {column.key: WORDS.get(value, value) if isinstance(value, str) else value
         for column in columns if (value := row.get(column.key)) is not None}
        for row in table.rows
    ]  # fmt: skip
    said = in_sentences(text) if isinstance(text, str) else text
    return Answer(said, replace(table, columns=columns, rows=rows), pictures)


def goals_answer(text: str, title: str, columns: Sequence[Column], goals: Sequence[Mapping[str, object]],
                 pictures: Sequence[Picture] = (), note: str = "") -> Answer:  # fmt: skip
    """Make the answer of a benchmark whose result is a list of goals: its table, missed goals first.

    Args:
        columns: of the table; that of the key ``reached`` shows marks.
        goals: rows, ``reached`` as `reached` takes it.
        note: below the table.
    """
    rows = [{**goal, "reached": reached(goal.get("reached"))} for goal in goals]
    rows.sort(key=lambda row: -row["reached"].rank)  # type: ignore[attr-defined]
    made = [replace(column, title="") if column.key == "reached" else column for column in columns]
    return Answer(in_sentences(text), Table(title, made, rows), pictures, note)


def interval_of(row: Mapping[str, Any], name: str) -> tuple[float, float, float] | None:
    """Return (low, value, high) of a row's figure, both ends the value where it has no interval; None without it."""
    value, low, high = (row.get(f"{name}{end}") for end in ("", "_low", "_high"))
    if value is None:
        return None
    return (low, value, high) if low is not None and high is not None and low == low else (value, value, value)


def interval_picture(
    intervals: Mapping[str, tuple[float, float, float]], tones: Mapping[str, str], x_label: str,
    limits: Mapping[str, float], *, log: bool = False,
) -> go.Figure:  # fmt: skip
    """Draw a point between two ends for each name, the first name at the top, and lines at the limits.

    Args:
        intervals: name -> (low, value, high).
        tones: name -> colour.
        x_label: of the axis.
        limits: words -> where a line stands.
        log: powers of ten on the axis.
    """
    drawn = figure(showlegend=False, height=90 + 24 * max(len(intervals), 4))
    for name, (low, value, high) in reversed(list(intervals.items())):
        drawn.add_scatter(
            x=[value], y=[label(name)], mode="markers", name=label(name),
            error_x={"type": "data", "symmetric": False, "array": [high - value], "arrayminus": [value - low],
                     "thickness": 1.5, "width": 5, "color": tones[name]},
            marker={"color": tones[name], "size": 9},
            hovertemplate=f"%{{x:.3g}} [{low:.3g}, {high:.3g}]<extra>%{{fullData.name}}</extra>",
        )  # fmt: skip
    if log:
        log_axis(drawn, "x", x_label, [*chain(*intervals.values()), *limits.values()])
    else:
        drawn.update_xaxes(title_text=pretty_units(x_label))
    for words, at in limits.items():
        rule(drawn, "x", at, words)
    drawn.update_yaxes(type="category", automargin=True)
    return drawn
