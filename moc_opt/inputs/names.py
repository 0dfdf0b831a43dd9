"""Check names from files, and escape texts for Markdown."""

from __future__ import annotations

import re

MAX_LENGTH = 100
RULE = (
    f"a name has 1 to {MAX_LENGTH} characters (ASCII letters, digits, spaces and _ - . : + /); it begins and ends with "
    "a letter, digit or _, and has no two dots in a row"
)
_NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_ .:+/-]*[A-Za-z0-9_])?")


def is_name(text: object) -> bool:
    """Return whether a text follows `RULE`."""
    return isinstance(text, str) and len(text) <= MAX_LENGTH and ".." not in text and bool(_NAME.fullmatch(text))


def checked(text: str) -> str:
    """Return a valid name unchanged. Raise a ValueError for any other text."""
    if not is_name(text):
        raise ValueError(f"{text!r:.80} is no name: {RULE}")
    return text


def in_markdown(text: str) -> str:
    """Escape a text for Markdown and HTML."""
    return re.sub(r"[^A-Za-z0-9 .,:;()/%°µ-]", lambda found: f"&#{ord(found.group())};", text)
