"""Names and texts from outside: which characters a name may have, and how any text is written so that it stays a text.

In a file's name, Markdown, and the table that an object shows of itself in a notebook.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

MAX_LENGTH = 100
ALPHABET = "letters, digits, spaces and _ - . : + /"
RULE = (
    f"a name has 1 to {MAX_LENGTH} characters, {ALPHABET} of ASCII; a letter, digit or _ stands first and last, "
    "and no two points beside each other"
)
_NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_ .:+/-]*[A-Za-z0-9_])?")
_IN_FILES = re.compile(r"[^A-Za-z0-9_.+ -]+")
_NOT_IN_MARKDOWN = re.compile(r"[^A-Za-z0-9 .,:;()/%°µ-]")

_TABLE = """\
<div><strong>{{ title }}</strong><table>
{%- if headings %}<tr>{% for text in headings %}<th>{{ text }}</th>{% endfor %}</tr>{% endif %}
{%- for row in rows %}<tr><th style="text-align:left">{{ row[0] }}</th>
{%- for text in row[1:] %}<td style="text-align:left">{{ text }}</td>{% endfor %}</tr>{% endfor %}</table>
{%- if caption %}<p>{{ caption }}</p>{% endif %}</div>"""


def is_name(text: object) -> bool:
    """Say whether ``text`` is a name of a robot, link, joint, scenario or solver; `RULE` says what that is."""
    return isinstance(text, str) and len(text) <= MAX_LENGTH and ".." not in text and bool(_NAME.fullmatch(text))


def checked(text: str) -> str:
    """Return a name as it is.

    Raises:
        ValueError: it is none; the message shows it and says what a name is.
    """
    if not is_name(text):
        raise ValueError(f"{text!r:.80} is no name: {RULE}")
    return text


def file_stem(text: str) -> str:
    """Write any text as a part of a file's name: no folder, no leading point, nothing a shell or system reads."""
    return _IN_FILES.sub("-", text).lstrip(" .-")[:MAX_LENGTH].rstrip(" .") or "unnamed"


def in_markdown(text: str) -> str:
    """Write any text so that Markdown, and the HTML that it lets through, shows it and does nothing else."""
    return _NOT_IN_MARKDOWN.sub(lambda found: f"&#{ord(found.group())};", text)


def table_html(title: str, rows: Mapping[str, object]) -> str:
    """Write a title and a table of names and values; every text is escaped.

    Args:
        rows: name -> value, written by ``str``.
    """
    return grid_html(title, rows.items())


def grid_html(title: str, rows: Iterable[Iterable[object]], headings: Iterable[str] = (), caption: str = "") -> str:
    """Write a table row by row under its headings, the first column set apart; every text is escaped."""
    from jinja2 import Environment  # late: a solver that never meets a notebook does not load it

    template = Environment(autoescape=True).from_string(_TABLE)
    texts = [[str(value) for value in row] for row in rows]
    return template.render(title=title, rows=texts, headings=list(headings), caption=caption)
