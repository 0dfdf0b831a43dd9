"""How an object shows itself in a notebook: a title above a plain table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

TEMPLATE = """\
<div><strong>{{ title }}</strong><table>
{%- if headings %}<tr>{% for text in headings %}<th>{{ text }}</th>{% endfor %}</tr>{% endif %}
{%- for row in rows %}<tr><th style="text-align:left">{{ row[0] }}</th>
{%- for text in row[1:] %}<td style="text-align:left">{{ text }}</td>{% endfor %}</tr>{% endfor %}</table>
{%- if caption %}<p>{{ caption }}</p>{% endif %}</div>"""


def table_html(title: str, rows: Mapping[str, object]) -> str:
    """Write a title and a table of names and values; every text is escaped.

    Args:
        rows: name -> value, written by ``str``.
    """
    return grid_html(title, rows.items())


def grid_html(title: str, rows: Iterable[Iterable[object]], headings: Iterable[str] = (), caption: str = "") -> str:
    """Write a table row by row under its headings, the first column set apart; every text is escaped."""
    from jinja2 import Environment  # late: a solver that never meets a notebook does not load it

    template = Environment(autoescape=True).from_string(TEMPLATE)
    texts = [[str(value) for value in row] for row in rows]
    return template.render(title=title, rows=texts, headings=list(headings), caption=caption)
