"""Adapt docstrings, where ``|x|`` is an absolute value, and the changelog, whose links begin at the checkout's root."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_LITERAL = re.compile(r"(``.*?``|`[^`]*`)")


def _sizes(app: Sphinx, kind: str, name: str, found: Any, options: Any, lines: list[str]) -> None:
    """Escape the bars of |x|, which Sphinx would read as the name of a substitution."""
    for i, line in enumerate(lines):
        parts = _LITERAL.split(line)
        lines[i] = "".join(part if part.startswith("`") else part.replace("|", "\\|") for part in parts)


def _links(app: Sphinx, relative: Any, parent: str, content: list[str]) -> None:
    content[0] = content[0].replace("](docs/", "](")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register both adaptations."""
    app.connect("autodoc-process-docstring", _sizes, priority=900)
    app.connect("include-read", _links)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
