"""Render HTML files from the templates in ``report/assets``, every text escaped, and save them all or nothing."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from moc_opt.errors import ReportError
from moc_opt.figures.notation import DASH, pretty_unit, printable
from moc_opt.inputs.files import check_replaceable, write_whole

GENERATOR = b'<meta name="generator" content="moc_opt">'  # marks a page as ours, in its first lines


def render(template: str, **values: Any) -> str:
    """Fill in a template of ``report/assets``; every value is escaped unless it is `Markup`."""
    return _TEMPLATES.get_template(template).render(values)


def macros(template: str) -> Any:
    """Return the macros of a template as functions that return `Markup`; every argument is escaped."""
    return _TEMPLATES.get_template(template).module


def asset(name: str) -> Markup:
    """Return the text of a style sheet or script in ``report/assets``, as it is."""
    return Markup(_LOADER.get_source(_TEMPLATES, name)[0].strip())


def inline(text: str) -> Markup:
    """Return a text for an element, with `backticks` as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(printable(text)))))


def inert(json: str) -> Markup:
    """Make JSON safe inside a script element: no text in it can end the element."""
    return Markup(json.replace("<", "\\u003c"))


def in_words(value: Any) -> str:
    """Return a plain value or a list of them as text, a dash where there is none."""
    if isinstance(value, (list, tuple)):
        return ", ".join(map(in_words, value)) or DASH
    return DASH if value is None or value in ("", {}) else str(value)


def anchor(title: str) -> str:
    """Return the address of a section on its page."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:60] or "part"


def _shown(value: Any) -> Any:
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


_LOADER = PackageLoader("moc_opt.report", "assets")
_TEMPLATES = Environment(
    loader=_LOADER, autoescape=True, undefined=StrictUndefined, finalize=_shown, trim_blocks=True, lstrip_blocks=True
)
_TEMPLATES.globals["asset"] = asset
_TEMPLATES.filters.update(inline=inline, inert=inert, in_words=in_words, anchor=anchor, pretty_unit=pretty_unit)


def check_out(path: str | os.PathLike[str], what: str, *, force: bool = False) -> Path:
    """Check before any work that a file can be written there, and return its path; else a ReportError.

    Only ``force`` replaces a file that is no page of moc_opt.
    """
    file = Path(path)
    check_replaceable(file, what, ReportError)
    if os.path.isfile(file) and not force:
        with suppress(OSError), file.open("rb") as content:
            if GENERATOR in content.read(2000):
                return file
        cure = "give another name, or --force"
        raise ReportError(f"{file}: this {what} would replace a file that is no page of moc_opt: {cure}")
    return file


def save_document(path: str | os.PathLike[str], text: str, what: str, *, force: bool = False) -> Path:
    """Write a page, all or nothing: an older one of that name stays until the new one is there."""
    return write_whole(check_out(path, what, force=force), text.encode(), what, ReportError)
