"""How an object shows itself in a notebook: a title above a plain table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape


def table_html(title: str, rows: Mapping[str, object]) -> str:
    """Write a title and a table of names and values; every text is escaped.

    Args:
        rows: name -> value, written by ``str``.
    """
    return grid_html(title, ((name, value) for name, value in rows.items()))


def grid_html(title: str, rows: Iterable[Iterable[object]], headings: Iterable[str] = (), caption: str = "") -> str:
    """Write a table row by row under its headings, the first column set apart; every text is escaped."""
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    lines = []
    for row in rows:
        first, *others = [escape(str(value)) for value in row]
        cells = "".join(f'<td style="text-align:left">{text}</td>' for text in others)
        lines.append(f'<tr><th style="text-align:left">{first}</th>{cells}</tr>')
    body = "".join(lines)
    return (
        f"<div><strong>{escape(title)}</strong><table>{f'<tr>{head}</tr>' if head else ''}{body}</table>"
        f"{f'<p>{escape(caption)}</p>' if caption else ''}</div>"
    )
