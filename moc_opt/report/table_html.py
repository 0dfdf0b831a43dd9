"""A table as HTML: headings that sort, numbers aligned on their decimal points, missing values with a footnote."""

from __future__ import annotations

import html
from collections.abc import Sequence
from string import ascii_lowercase
from textwrap import wrap
from typing import TYPE_CHECKING, Literal

from moc_opt.report.notation import Missing, fraction_length, pretty_unit, printable, typeset

if TYPE_CHECKING:
    from moc_opt.report.tables import Cell, Column, Table

# As wide as a digit and as a point, where figures are tabular: they align numbers on their points.
FIGURE_SPACE, POINT_SPACE = "\u2007", "\u2008"
HEADING_WIDTH, LONG_TEXT = 10, 40


def escape(text: str) -> str:
    """Text that is safe inside an element and inside a quoted attribute."""
    return html.escape(printable(text), quote=True)


def draw(table: Table, number: int | None) -> str:
    """The whole fragment: caption, scrolling box, table, footnotes."""
    columns = [table.cells(column) for column in table.columns]
    letters = _footnotes(columns)
    heads = [_heading(column, cells) for column, cells in zip(table.columns, columns, strict=True)]
    drawn = [
        _cells(column, cells, letters, heading=place == 0)
        for place, (column, cells) in enumerate(zip(table.columns, columns, strict=True))
    ]
    body = "\n".join(f"<tr>{''.join(row)}</tr>" for row in zip(*drawn, strict=True))
    label = f"Table {number}. " if number else ""
    title = escape(table.title) + ("" if table.title.endswith(("?", "!", ".")) else ".")
    caption = f" {escape(table.caption)}" if table.caption else ""
    notes = " ".join(
        f"<span><sup>{letter}</sup>&nbsp;{escape(reason)}</span>" for reason, letter in letters.items()
    )
    name = f'aria-label="{escape(table.title)}"'
    return (
        f'<figure class="table"><figcaption><b>{label}{title}</b>{caption}</figcaption>'
        f'<div class="scroll" tabindex="0" role="region" {name}><table {name}>'
        f"<thead><tr>{''.join(heads)}</tr></thead>\n<tbody>{body}</tbody></table></div>"
        + (f'<p class="notes">{notes}</p>' if notes else "")
        + _explanations(table.columns)
        + "</figure>"
    )


def alignment(cells: Sequence[Cell]) -> Literal["left", "right"]:
    """Numbers to the right, unless there are none."""
    values = [cell for cell in cells if cell.why is None]
    return "right" if all(cell.numeric for cell in values) and cells else "left"


def _footnotes(columns: Sequence[Sequence[Cell]]) -> dict[str, str]:
    """Reason -> letter, in the order in which a reader meets them; what says nothing gets no letter."""
    rows = zip(*columns, strict=True)
    reasons = [
        cell.why.reason for row in rows for cell in row if cell.why is not None and cell.why != Missing()
    ]
    return dict(zip(dict.fromkeys(reasons), ascii_lowercase, strict=False))


def _explanations(columns: Sequence[Column]) -> str:
    """What the columns mean, folded: a finger has no way to point at a heading."""
    terms = [
        f"<dt>{escape(column.title)}</dt><dd>{escape(column.help)}</dd>" for column in columns if column.help
    ]
    if not terms:
        return ""
    return f'<details class="columns"><summary>What the columns mean</summary><dl>{"".join(terms)}</dl></details>'


def _heading(column: Column, cells: Sequence[Cell]) -> str:
    align = column.align or alignment(cells)
    first = "descending" if column.better == "high" else "ascending"
    hint = f' title="{escape(column.help)}"' if column.help else ""
    unit = f'<span class="unit">{escape(pretty_unit(column.unit))}</span>' if column.unit else ""
    return (
        f'<th scope="col" class="{align}" aria-sort="none" data-first="{first}">'
        f'<button type="button"{hint}>{_lines(column.title)}{unit}</button></th>'
    )


def _lines(title: str) -> str:
    """A heading that may break, but not into scraps."""
    return " ".join(escape(line).replace(" ", "&nbsp;") for line in wrap(title, HEADING_WIDTH)) or "&nbsp;"


def _cells(column: Column, cells: Sequence[Cell], letters: dict[str, str], heading: bool) -> list[str]:
    align = column.align or alignment(cells)
    numbers = [cell.text for cell in cells if cell.numeric]
    fraction = max(map(fraction_length, numbers), default=0)
    power = max((len(text.partition("e")[2]) for text in numbers), default=0)
    tag, scope = ("th", ' scope="row"') if heading else ("td", "")
    drawn = []
    for cell in cells:
        order = "" if cell.sort is None else f' data-sort="{escape(str(cell.sort))}"'
        mark = " best" if cell.best else " long" if not cell.numeric and len(cell.text) > LONG_TEXT else ""
        drawn.append(
            f'<{tag}{scope} class="{align}{mark}"{order}>{_content(cell, fraction, power, letters)}</{tag}>'
        )
    return drawn


def _content(cell: Cell, fraction: int, power: int, letters: dict[str, str]) -> str:
    if cell.why is not None:
        letter = letters.get(cell.why.reason, "")
        note = f"<sup>{letter}</sup>" if letter else ""
        reason = escape(cell.why.reason)
        return (
            f'<span class="missing" title="{reason}" aria-label="missing: {reason}">{cell.text}{note}</span>'
        )
    if not cell.numeric:
        return escape(cell.text)
    own = fraction_length(cell.text)
    # An integer in a column of fractions lacks the point as well as the digits after it.
    pad = (POINT_SPACE if fraction and not own else "") + FIGURE_SPACE * (fraction - max(own, 1))
    written = typeset(escape(cell.text), power) + (pad if "e" not in cell.text else "")
    return f"<strong>{written}</strong>" if cell.best else written
