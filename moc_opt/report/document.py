"""Render HTML files from templates, and save them."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from moc_opt.errors import ReportError
from moc_opt.figures.notation import pretty_unit, printable
from moc_opt.inputs.files import check_replaceable, write_whole
from moc_opt.report.tables import heading_lines

GENERATOR = b'<meta name="generator" content="moc_opt">'  # marks pages written by moc_opt


def render(template: str, **values: Any) -> str:
    """Fill in a template of ``report/assets``; escape all values but `Markup`."""
    return _TEMPLATES.get_template(template).render(values)


def macros(template: str) -> Any:
    """Return the macros of a template as functions that escape their arguments."""
    return _TEMPLATES.get_template(template).module


def inline(text: str) -> Markup:
    """Return a text as escaped HTML, with `backticks` as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(printable(text)))))


def anchor(title: str) -> str:
    """Return the URL fragment of a section."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:60] or "part"


def _shown(value: Any) -> Any:
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


_TEMPLATES = Environment(
    loader=PackageLoader("moc_opt.report", "assets"), autoescape=True, undefined=StrictUndefined, finalize=_shown,
    trim_blocks=True, lstrip_blocks=True,
)  # fmt: skip
_TEMPLATES.filters.update(inline=inline, anchor=anchor, pretty_unit=pretty_unit, heading_lines=heading_lines)


def check_out(path: str | os.PathLike[str], what: str, *, force: bool = False) -> Path:
    """Return the path if a file can be written there; else raise a ReportError.

    A file that is no page of moc_opt is replaced only with ``force``.
    """
    file = check_replaceable(path, what, ReportError)
    if os.path.isfile(file) and not force:
        with suppress(OSError), file.open("rb") as content:
            if GENERATOR in content.read(2000):
                return file
        cure = "give another name, or --force"
        raise ReportError(f"{file}: this {what} would replace a file that is no page of moc_opt: {cure}")
    return file


def save_document(path: str | os.PathLike[str], text: str, what: str, *, force: bool = False) -> Path:
    """Write a page atomically."""
    return write_whole(check_out(path, what, force=force), text.encode(), what, ReportError)
