"""Markdown for README.md and docs/: tables, sections between marks, and pages from benchmarks/templates."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from benchmarks.common.output import write_atomically
from moc_opt.errors import MocOptError
from moc_opt.report.tables import Column, Table

_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parents[1] / "templates"), undefined=StrictUndefined, trim_blocks=True,
    keep_trailing_newline=True, autoescape=False,
)  # fmt: skip


class SectionError(MocOptError, ValueError):
    """A page has no marks for what should stand there."""


def render(template: str, **values: Any) -> str:
    """Fill in a template; a value that it names and that is not given is an error."""
    return _TEMPLATES.get_template(template).render(values)


def row(cells: Iterable[str]) -> str:
    """Write one row of a table."""
    return "| " + " | ".join(cells) + " |"


def table(heads: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """Write a table, from its headings and rows of texts."""
    return "\n".join([row(heads), "|" + "---|" * len(heads), *map(row, rows)])


def of_columns(columns: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> str:
    """Write a table of results in the notation of terminal and page."""
    heads = [f"{c.title} [{c.unit}]" if c.unit else c.title for c in columns]
    cells = [[cell.text for cell in Table("", columns, rows).cells(column)] for column in columns]
    return table(heads, zip(*cells, strict=True))


def fill_section(page: str, name: str, text: str, where: str | Path) -> str:
    """Put a text between the lines ``<!-- name -->`` and ``<!-- /name -->`` of a page.

    Raises:
        SectionError: the page, which is called ``where``, has no such lines.
    """
    marks = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    filled, found = marks.subn(lambda at: f"{at[1]}{text}\n{at[2]}", page)
    if not found:
        raise SectionError(f"{where}: no lines <!-- {name} --> and <!-- /{name} -->: put them where the figures belong")
    return filled


def write_section(page: Path, name: str, text: str) -> None:
    """Put a text between the marks of a page's file, as `fill_section` does.

    Raises:
        SectionError: the page has no such marks.
    """
    write_atomically(page, fill_section(page.read_text(encoding="utf-8"), name, text, page).encode())
