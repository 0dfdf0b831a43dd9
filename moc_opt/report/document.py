"""What every HTML file of ours has: the same head and colours, a limit of size, and it is written all or nothing."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from importlib import resources
from pathlib import Path
from string import Template
from urllib.parse import quote

from moc_opt.errors import ReportError
from moc_opt.inputs.files import check_replaceable
from moc_opt.report.table_html import escape

MAX_BYTES = 8_000_000
# A piece of a path: no scheme's colon, no backslash that browsers read as a slash, nothing that leads upwards.
PIECE = re.compile(r"(?!\.+$)[\w.()+, -]+")


def document(title: str, style: str, body: str) -> str:
    """A whole file as text.

    Args:
        title: plain text; it is escaped.
        style: name of the asset with its style sheet, after that which all files share.
        body: HTML, its scripts included.
    """
    styles = f"{asset('document.css')}\n{asset(style)}"
    return Template(asset("document.html")).substitute(title=escape(title), style=styles, body=body)


def asset(name: str) -> str:
    """The text of a file in ``report/assets``."""
    return resources.files("moc_opt.report").joinpath("assets", name).read_text(encoding="utf-8").strip()


def script_data(name: str, text: str) -> str:
    """JSON for a page's scripts, under an id; no text in it can end the element."""
    inert = text.replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{inert}</script>'


def beside(target: str) -> str:
    """The address of a file that lies beside a page or below it, ready for an attribute.

    Args:
        target: a relative path with slashes, and after a ``#`` a place in the file.

    Raises:
        ReportError: it is anything else: an address of another host, a scheme, an absolute path, or one upwards.
    """
    path, _, place = target.partition("#")
    if not all(PIECE.fullmatch(piece) for piece in path.split("/")):
        raise ReportError(
            f"link to {target!r}: give a file beside the page or below it, such as 'replay.html'"
        )
    return escape(quote(path) + (f"#{quote(place, safe='=')}" if place else ""))


def save_document(path: str | os.PathLike[str], text: str, what: str, cure: Callable[[], str]) -> Path:
    """Write a file, all or nothing: an older one of that name stays until the new one is there.

    Args:
        path: of the file; its folder is made.
        text: what is in it.
        what: it is: "page".
        cure: what to do where it is too large; asked only then.

    Raises:
        ReportError: it would be larger than MAX_BYTES, or cannot be written.
    """
    file, content = Path(path), text.encode()
    if len(content) > MAX_BYTES:
        sizes = f"{len(content) / 1e6:.1f} MB, more than {MAX_BYTES / 1e6:.0f}"
        raise ReportError(f"{file}: the {what} has {sizes}: {cure()}")
    check_replaceable(file, what, ReportError)
    unfinished = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_bytes(content)
        unfinished.replace(file)
    except OSError as error:
        # Where there was no folder, there is nothing to clear away either.
        with suppress(OSError):
            unfinished.unlink()
        raise ReportError(f"{file}: cannot be written: {error.strerror or error}") from error
    return file
