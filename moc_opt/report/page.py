"""A report as one HTML file that opens by itself: no other file, no other host."""

from __future__ import annotations

import base64
import gzip
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from string import ascii_lowercase
from types import MappingProxyType
from typing import Any

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from moc_opt.figures.notation import Missing, fraction_length, pretty_unit
from moc_opt.figures.style import DARK
from moc_opt.inputs.files import to_json
from moc_opt.report.document import anchor, beside, macros, render, save_document
from moc_opt.report.tables import Cell, Column, Table, alignment, heading_lines

# As wide as a digit and as a point, where figures are tabular: they align numbers on their points.
FIGURE_SPACE, POINT_SPACE = "\u2007", "\u2008"
LONG_TEXT = 40


class Page:
    """A report: call its methods in reading order, then `save`.

    All texts are plain: they are escaped, a blank line begins a paragraph, and `backticks` set a name in code.
    """

    def __init__(self, title: str, subtitle: str = "") -> None:
        self.title, self.subtitle = title, subtitle
        self._parts: list[Markup] = []
        self._sections: dict[str, str] = {}
        self._macros = macros("parts.html")
        self._figures: dict[str, go.Figure] = {}
        self._headlines: list[str] = []
        self._tables = 0
        self._folding, self._open = False, False

    @property
    def figures(self) -> Mapping[str, go.Figure]:
        """Name -> figure, in the order of the page: what `save_figures` takes."""
        return MappingProxyType(self._figures)

    def headline(self, text: str) -> None:
        """Append a finding in words, set apart; the first one describes the page to an index."""
        self._headlines.append(text)
        self._parts.append(self._macros.headline(text))

    def section(self, title: str) -> None:
        """Begin a section; the table of contents lists it. Behind `fold` it is folded until the reader opens it."""
        name = self._name(title, self._sections)
        self._sections[name] = title
        self._close()
        self._open = self._folding
        self._parts.append((self._macros.folding if self._folding else self._macros.section)(name, title))

    def fold(self) -> None:
        """Fold every section from here on, under a field that finds rows in all tables of the page."""
        self._close()
        self._folding = True
        self._parts.append(self._macros.finder())

    def _close(self) -> None:
        if self._open:
            self._parts.append(Markup("</details>"))
        self._open = False

    def text(self, text: str) -> None:
        """Append paragraphs."""
        self._parts += [self._macros.paragraph(part) for part in re.split(r"\n\s*\n", text.strip()) if part]

    def link(self, target: str, text: str, about: str = "") -> None:
        """Append a paragraph with a link to a file that lies beside the page; the page is complete without it.

        Args:
            target: relative path of that file, such as "replay.html", or "replay.html#t=3".

        Raises:
            ReportError: the target is not beside or below the page: no other host, scheme or folder above is allowed.
        """
        self._parts.append(self._macros.link(beside(target), text, about))

    def table(self, table: Table) -> None:
        """Append a numbered table."""
        self._tables += 1
        self._parts.append(draw(table, self._tables))

    def figure(self, figure: go.Figure, caption: str, *, name: str = "") -> None:
        """Append a numbered figure.

        Args:
            figure: of `moc_opt.figures`, or any plotly figure.
            caption: the content of the figure, and the point to notice.
            name: of its file, where the figures are saved too; from the caption's first words if empty.
        """
        name = self._name(name or " ".join(caption.split()[:5]), self._figures)
        self._figures[name] = figure
        height = int(figure.layout.height or figure.layout.template.layout.height or 450)
        self._parts.append(self._macros.figure(name, len(self._figures), caption, height))

    def environment(self, values: Mapping[str, Any], title: str = "Environment") -> None:
        """Append a section on how the numbers came about: machine, versions, seed, configuration.

        Args:
            values: nested mappings and lists of plain values; every mapping at the top is folded away.
        """
        self.section(title)
        plain = {key: value for key, value in values.items() if not isinstance(value, Mapping)}
        if plain:
            self._parts.append(self._macros.definitions(plain))
        for key, value in values.items():
            if isinstance(value, Mapping):
                self._parts.append(self._macros.folded(key, value))

    def html(self) -> str:
        """Return the whole file as text."""
        closing = [Markup("</details>")] if self._open else []
        data = {f"{name}-data": _plain_json(figure) for name, figure in self._figures.items()}
        if self._figures:
            data |= {"dark-colors": to_json(DARK, indent=None), "plotly-packed": _packed_plotly()}
        return render(
            "page.html", title=self.title, subtitle=self.subtitle,
            sections={} if self._folding else self._sections,  # folded, their titles are the contents
            parts=[*self._parts, *closing], about=self._headlines[0] if self._headlines else "", data=data,
            figures=self._figures,
        )  # fmt: skip

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the file, all or nothing: an older one of that name stays until the new one is there.

        Args:
            path: of the file.
            force: replace a file that is no page of moc_opt, too.

        Raises:
            ReportError: it would be larger than `document.MAX_BYTES`, or cannot be written.
        """
        return save_document(path, self.html(), "page", self._thinner, force=force)

    def _thinner(self) -> str:
        sizes = {name: len(_plain_json(figure)) for name, figure in self._figures.items()}
        largest = sorted(sizes, key=lambda name: -sizes[name])[:3]
        return f"thin out its largest figures: {', '.join(f'{name} ({sizes[name] / 1e6:.1f} MB)' for name in largest)}"

    @staticmethod
    def _name(text: str, taken: Iterable[str]) -> str:
        """Return a name for addresses and files, unlike those that are taken."""
        words = anchor(text)
        name, count = words, 1
        while name in taken:
            count += 1
            name = f"{words}-{count}"
        return name


def _plain_json(figure: go.Figure) -> str:
    text: str = figure.to_json()
    return text


@cache
def _packed_plotly() -> str:
    """Return plotly.js, compressed: a third of its size even in base64; `figures.js` unpacks it."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


# --- a table: headings that sort, numbers aligned on their points, missing values with a footnote ---


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
    lines = [line.replace(" ", "\u00a0") for line in heading_lines(column.title)]
    return {
        "column": column, "align": column.align or alignment(cells), "lines": lines,
        "first": "descending" if column.better == "high" else "ascending", "unit": pretty_unit(column.unit),
    }  # fmt: skip


def _column(
    column: Column, cells: list[Cell], notes: dict[str, str], rows: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
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
