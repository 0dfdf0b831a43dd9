"""Names from outside: which characters a name may have, and how any other text is escaped."""

from __future__ import annotations

import re
from collections.abc import Iterable
from html import escape

MAX_LENGTH = 100
RULE = (
    f"a name has 1 to {MAX_LENGTH} characters, letters, digits, spaces and _ - . : + / of ASCII; a letter, digit or _ "
    "stands first and last, and no two points beside each other"
)
_NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_ .:+/-]*[A-Za-z0-9_])?")


def is_name(text: object) -> bool:
    """Say whether ``text`` can name a robot, link, joint, scenario or solver (see `RULE`)."""
    return isinstance(text, str) and len(text) <= MAX_LENGTH and ".." not in text and bool(_NAME.fullmatch(text))


def checked(text: str) -> str:
    """Return a name as it is; a ValueError where it is none."""
    if not is_name(text):
        raise ValueError(f"{text!r:.80} is no name: {RULE}")
    return text


def file_stem(text: str) -> str:
    """Write any text as a part of a file's name: no folder, no leading point, nothing that a shell reads."""
    stem = re.sub(r"[^A-Za-z0-9_.+ -]+", "-", text)
    return stem.lstrip(" .-")[:MAX_LENGTH].rstrip(" .") or "unnamed"


def in_markdown(text: str) -> str:
    """Escape a text, so that Markdown and the HTML in it show it and do nothing else."""
    return re.sub(r"[^A-Za-z0-9 .,:;()/%°µ-]", lambda found: f"&#{ord(found.group())};", text)


def grid_html(title: str, rows: Iterable[Iterable[object]], headings: Iterable[str] = (), caption: str = "") -> str:
    """Write a title and a table row by row, the first column set apart; every text is escaped."""
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = [f"<tr>{head}</tr>" if head else ""]
    for row in rows:
        first, *others = (escape(str(value)) for value in row)
        cells = "".join(f'<td style="text-align:left">{text}</td>' for text in others)
        body.append(f'<tr><th style="text-align:left">{first}</th>{cells}</tr>')
    below = f"<p>{escape(caption)}</p>" if caption else ""
    return f"<div><strong>{escape(title)}</strong><table>{''.join(body)}</table>{below}</div>"
