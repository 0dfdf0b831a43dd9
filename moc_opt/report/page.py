"""A report as one HTML file that needs no other file."""

from __future__ import annotations

import base64
import gzip
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from moc_opt.figures.notation import Missing, fraction_length
from moc_opt.figures.style import DARK
from moc_opt.inputs.files import to_json
from moc_opt.report.document import anchor, macros, render, save_document
from moc_opt.report.tables import Cell, Column, Table, alignment

# Spaces as wide as a digit and as a decimal point, to align numbers at the point.
FIGURE_SPACE, POINT_SPACE = "\u2007", "\u2008"
LONG_TEXT = 40
_PARTS, _TABLE = macros("parts.html"), macros("table.html")


@dataclass
class _Section:
    name: str = ""
    title: str = ""
    folded: bool = False
    parts: list[Markup] = field(default_factory=list)


class Page:
    """A report. Call its methods in reading order, then `save`.

    All texts are escaped, and `backticks` mark code.
    """

    def __init__(self, title: str, subtitle: str = "") -> None:
        self.title, self.subtitle = title, subtitle
        self.figures: dict[str, go.Figure] = {}  #: figures by name, for `save_figures`
        self._sections = [_Section()]
        self._about, self._tables, self._folding = "", 0, False

    def headline(self, text: str) -> None:
        """Append a highlighted finding."""
        self._about = self._about or text
        self._add(_PARTS.headline(text))

    def section(self, title: str) -> None:
        """Begin a section, folded if `fold` was called before."""
        name = _unlike(title, [section.name for section in self._sections])
        self._sections.append(_Section(name, title, self._folding))

    def fold(self) -> None:
        """Fold all later sections, and put a search field above them."""
        self._folding = True
        self._sections.append(_Section(parts=[_PARTS.finder()]))

    def text(self, text: str) -> None:
        """Append paragraphs, separated by blank lines."""
        for paragraph in filter(None, text.split("\n\n")):
            self._add(_PARTS.paragraph(paragraph))

    def table(self, table: Table) -> None:
        """Append a numbered table."""
        self._tables += 1
        self._add(_drawn(table, self._tables))

    def figure(self, figure: go.Figure, caption: str, *, name: str = "") -> None:
        """Append a numbered figure; ``name`` is its name in `save_figures`."""
        name = _unlike(name or " ".join(caption.split()[:5]), self.figures)
        self.figures[name] = figure
        height = int(figure.layout.height or figure.layout.template.layout.height or 450)
        self._add(_PARTS.figure(name, len(self.figures), caption, height))

    def environment(self, values: Mapping[str, Any]) -> None:
        """Append a section of nested plain values."""
        self.section("Environment")
        self._add(_PARTS.environment(values))

    def _add(self, part: Markup) -> None:
        self._sections[-1].parts.append(part)

    def html(self) -> str:
        """Return the whole file as text."""
        data = {f"{name}-data": str(figure.to_json()) for name, figure in self.figures.items()}
        if self.figures:
            data |= {"dark-colors": to_json(DARK, indent=None), "plotly-packed": _packed_plotly()}
        contents = [] if self._folding else [section for section in self._sections if section.title]
        return render(
            "page.html", title=self.title, subtitle=self.subtitle, about=self._about, contents=contents,
            sections=self._sections, data=data,
        )  # fmt: skip

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the file, as `save_document` does."""
        return save_document(path, self.html(), "page", force=force)


def _unlike(text: str, taken: Iterable[str]) -> str:
    """Turn a text into an unused name for URLs and files."""
    words = anchor(text)
    return next(name for k in count(1) if (name := f"{words}-{k}" if k > 1 else words) not in taken)


@cache
def _packed_plotly() -> str:
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


# --- tables ---


def _drawn(table: Table, number: int) -> Markup:
    cells = {column: table.cells(column) for column in table.columns}
    reasons = dict.fromkeys(
        cell.why.reason for row in zip(*cells.values(), strict=True) for cell in row
        if cell.why is not None and cell.why != Missing()
    )  # fmt: skip
    notes = dict(zip(reasons, ascii_lowercase, strict=False))
    alignments = {column: alignment(of) for column, of in cells.items()}
    rows = list(zip(*(_column(column, of, table.rows, notes) for column, of in cells.items()), strict=True))
    return Markup(_TABLE.draw(number, table, alignments, rows, notes))


def _column(
    column: Column, cells: list[Cell], rows: Sequence[Mapping[str, Any]], notes: Mapping[str, str]
) -> Iterator[dict[str, Any]]:
    align = alignment(cells)
    numbers = [cell.text for cell in cells if cell.numeric]
    fraction = max(map(fraction_length, numbers), default=0)
    power = max((len(text.partition("e")[2]) for text in numbers), default=0)
    for cell, row in zip(cells, rows, strict=True):
        own = fraction_length(cell.text)
        pad = POINT_SPACE * bool(fraction and not own) + FIGURE_SPACE * (fraction - max(own, 1))
        long = not cell.numeric and len(cell.text) > LONG_TEXT
        yield {
            "value": cell, "power": power, "pad": "" if "e" in cell.text else pad,
            "look": align + (" best" if cell.best else f" tone-{cell.tone}" if cell.tone else " long" * long),
            "section": row.get(column.sections) or column.section,
            "letter": notes.get(cell.why.reason) if cell.why else None,
        }  # fmt: skip
