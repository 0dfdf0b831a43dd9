"""Draw a table as HTML: headings that sort, numbers aligned on their decimal points, missing values with a footnote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from string import ascii_lowercase
from textwrap import wrap
from typing import Any

from markupsafe import Markup

from moc_opt.figures.notation import Missing, fraction_length, pretty_unit, printable
from moc_opt.report.document import macros
from moc_opt.report.tables import Cell, Column, Table, alignment

# As wide as a digit and as a point, where figures are tabular: they align numbers on their points.
FIGURE_SPACE, POINT_SPACE = "\u2007", "\u2008"
HEADING_WIDTH, LONG_TEXT = 10, 40


def draw(table: Table, number: int | None = None) -> Markup:
    """Draw the table as a fragment of a page, sortable there; every text is escaped.

    Args:
        number: of the table on its page.
    """
    columns = {column: table.cells(column) for column in table.columns}
    reasons = [
        cell.why.reason for row in zip(*columns.values(), strict=True) for cell in row
        if cell.why is not None and cell.why != Missing()
    ]  # fmt: skip
    notes = dict(zip(dict.fromkeys(reasons), ascii_lowercase, strict=False))
    drawn = [_column(column, cells, notes, table.rows) for column, cells in columns.items()]
    headings = [_heading(column, cells) for column, cells in columns.items()]
    made: Markup = macros("table.html").draw(
        number, table.title, table.caption, headings, list(zip(*drawn, strict=True)), notes
    )
    return made


def _heading(column: Column, cells: list[Cell]) -> dict[str, Any]:
    # A heading may break between lines of ten characters, but not into scraps.
    lines = [line.replace(" ", "\u00a0") for line in wrap(printable(column.title), HEADING_WIDTH)]
    return {
        "column": column, "align": column.align or alignment(cells), "lines": lines,
        "first": "descending" if column.better == "high" else "ascending", "unit": pretty_unit(column.unit),
    }  # fmt: skip


def _column(
    column: Column, cells: list[Cell], notes: dict[str, str], rows: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return the cells of one column as the template takes them."""
    align = column.align or alignment(cells)
    numbers = [cell.text for cell in cells if cell.numeric]
    fraction = max(map(fraction_length, numbers), default=0)
    power = max((len(text.partition("e")[2]) for text in numbers), default=0)
    drawn = []
    for cell, row in zip(cells, rows, strict=True):
        own = fraction_length(cell.text)
        # An integer in a column of fractions lacks the point as well as the digits after it.
        pad = (POINT_SPACE if fraction and not own else "") + FIGURE_SPACE * (fraction - max(own, 1))
        long = not cell.numeric and len(cell.text) > LONG_TEXT
        mark = " best" if cell.best else f" tone-{cell.tone}" if cell.tone else " long" if long else ""
        drawn.append(
            {
                "text": cell.text, "sort": cell.sort, "look": align + mark, "numeric": cell.numeric, "best": cell.best,
                "power": power, "pad": "" if "e" in cell.text else pad, "why": cell.why,
                "section": row.get(column.sections) or column.section,
                "letter": notes.get(cell.why.reason) if cell.why else None,
            }
        )  # fmt: skip
    return drawn
