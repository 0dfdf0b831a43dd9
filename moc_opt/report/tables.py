"""A table of results for the terminal and for a page."""

from __future__ import annotations

import io
import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from textwrap import wrap
from typing import Any, Literal, NamedTuple

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions
from rich.table import Table as RichTable
from rich.text import Text

from moc_opt.errors import is_number
from moc_opt.figures import notation
from moc_opt.figures.notation import Mark, Missing, Notation, printable

SHORT_TEXT, HEADING = 14, 10  # longest unbroken text, and longest line of a heading [characters]
GAP = 2  # characters that a column needs beside its text

TONES = {"best": "bold green", "good": "green", "fair": "yellow", "bad": "red", "other": "cyan"}


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    key: str  #: key of the value in a row
    title: str
    unit: str = ""
    format: str = ""  #: format specification (".2f"); empty: three significant digits
    better: Literal["low", "high"] | None = None
    help: str = ""
    among: str = ""  #: key of a flag: only rows with this flag can be best
    section: str = ""  #: section of the page to which the values link
    sections: str = ""  #: key of the row's entry that names the section to link to; it replaces `section` for that row


@dataclass(frozen=True)
class Cell:
    """A value as text, with a key for sorting (None: last)."""

    text: str
    sort: float | str | None
    numeric: bool = False
    why: Missing | None = None
    best: bool = False
    tone: str = ""


@dataclass(frozen=True, repr=False)
class Table:
    """Rows of results under typed columns. The first column names the row.

    A value is a text, flag, number, None, `Missing` or `Mark`.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Mapping[str, Any]] = field(default_factory=list)
    caption: str = ""

    def cells(self, column: Column) -> list[Cell]:
        """Return the cells of a column."""
        values = [row.get(column.key) for row in self.rows]
        written = Notation.of(values, spec=column.format)
        cells = [_cell(value, written) for value in values]
        competing = [
            cell for cell, row in zip(cells, self.rows, strict=True)
            if cell.numeric and (not column.among or row.get(column.among))
        ]  # fmt: skip
        finite = [cell for cell in competing if math.isfinite(float(cell.sort or 0.0))]
        if column.better is None or len(finite) < 2:
            return cells
        winner = (min if column.better == "low" else max)(finite, key=lambda cell: float(cell.sort or 0.0))
        # Values with the winner's text are best, too. If more than half of the values are best, none is marked.
        ahead = [cell for cell in competing if cell.text == winner.text]
        if len(ahead) > max(1, len(competing) / 2):
            return cells
        return [replace(cell, best=any(cell is one for one in ahead)) for cell in cells]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RichTable | Text]:
        width, parts = options.max_width, list[list[_Column]]()
        made = [self._column(column, max(SHORT_TEXT, 0 if k else width // 2)) for k, column in enumerate(self.columns)]
        rest = made[1:]
        while rest or not parts:  # split a wide table; each part begins with the first column
            part = [*made[:1], *rest]
            while len(part) > 2 and sum(column.least + GAP for column in part) > width:
                part.pop()
            parts.append(part)
            rest = rest[len(part) - 1 :]
        for place, part in enumerate(parts):
            yield _drawn(part, width, "" if place else self.title, "" if parts[1:] else self.caption)
        if parts[1:] and self.caption:
            yield Text(printable(self.caption), style="table.caption")

    def _column(self, column: Column, unbroken: int) -> _Column:
        """Prepare a column. Texts shorter than ``unbroken`` stay on one line."""
        cells = self.cells(column)
        looks = ("bold" if cell.best else "dim" if cell.why else TONES.get(cell.tone, "") for cell in cells)
        heading = Text("\n".join(heading_lines(column.title)))
        if column.unit:
            heading.append(f"\n{notation.pretty_unit(column.unit)}", style="dim")
        title = max(map(cell_len, heading.plain.splitlines()), default=0)
        justify, widest = alignment(cells), max((cell_len(cell.text) for cell in cells), default=0)
        least = widest if justify == "right" or widest < unbroken else SHORT_TEXT
        texts = [Text(cell.text, style=look) for cell, look in zip(cells, looks, strict=True)]
        return _Column(heading, texts, justify, max(least, title), max(widest, title))

    def __repr__(self) -> str:
        return self.to_text(shutil.get_terminal_size((200, 24)).columns)

    def texts(self) -> tuple[list[str], list[tuple[str, ...]]]:
        """Return the headings with units, and the cells' texts row by row."""
        headings = [f"{column.title} [{column.unit}]" if column.unit else column.title for column in self.columns]
        return headings, list(zip(*([cell.text for cell in self.cells(of)] for of in self.columns), strict=True))

    def to_text(self, width: int = 10_000) -> str:
        """Return the table as plain text, at most ``width`` characters wide."""
        file = io.StringIO()
        screen = Console(
            file=file, width=width, color_system=None, force_terminal=False, highlight=False,
            force_jupyter=False,  # in Jupyter, rich would show the table instead
        )  # fmt: skip
        screen.print(self)
        return "\n".join(line.rstrip() for line in file.getvalue().splitlines()) + "\n"


class _Column(NamedTuple):
    heading: Text
    cells: list[Text]
    justify: Literal["left", "right"]
    least: int  #: width at which no number, name or heading is broken
    most: int  #: width without any line break


def _drawn(shown: Sequence[_Column], width: int, title: str, caption: str) -> RichTable:
    drawn = RichTable(
        box=box.SIMPLE_HEAD, pad_edge=False, title_justify="left", caption_justify="left", padding=(0, 1, 0, 0)
    )
    drawn.title = Text(printable(title), style="bold") if title else None
    drawn.caption = Text(printable(caption)) if caption else None
    # Rich would cut off columns whose minimum widths do not fit.
    widths = [column.least for column in shown]
    spare = width - sum(widths) - GAP * len(shown)
    for _ in range(-spare):
        widest = max(widths)
        widths[widths.index(widest)] = max(1, widest - 1)
    lacking = [column.most - column.least for column in shown]
    for _ in range(min(spare, sum(lacking))):
        widest = lacking.index(max(lacking))
        widths[widest] += 1
        lacking[widest] -= 1
    for column, given in zip(shown, widths, strict=True):
        drawn.add_column(column.heading, justify=column.justify, overflow="fold", width=given)
    for row in zip(*(column.cells for column in shown), strict=True):
        drawn.add_row(*row)
    return drawn


def heading_lines(title: str) -> list[str]:
    """Break a heading into lines of at most `HEADING` characters."""
    return wrap(printable(title), HEADING, break_long_words=False, break_on_hyphens=False)


def alignment(cells: Sequence[Cell]) -> Literal["left", "right"]:
    """Return "right" if all values are numbers, else "left"."""
    values = [cell for cell in cells if cell.why is None]
    return "right" if all(cell.numeric for cell in values) and cells else "left"


def _cell(value: Any, written: Notation) -> Cell:
    why = notation.missing(value)
    if why is not None:
        return Cell(notation.DASH, None, why=why)
    if isinstance(value, Mark):
        return Cell(printable(f"{value.symbol} {value.word}".strip()), float(value.rank), tone=value.tone)
    if is_number(value):
        return Cell(written(value), float(value), numeric=True)
    if type(value).__name__ in ("bool", "bool_"):
        return Cell("yes" if value else "no", "yes" if value else "no")
    return Cell(printable(str(value)), str(value))
