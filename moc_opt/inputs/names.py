"""Names from outside: which characters they may have, and how a text is written where it must stay a text."""

from __future__ import annotations

import re

MAX_LENGTH = 100
ALPHABET = "letters, digits, spaces and _ - . : + /"
RULE = (
    f"a name has 1 to {MAX_LENGTH} characters, {ALPHABET} of ASCII; a letter, digit or _ stands first and last, "
    "and no two points beside each other"
)
_NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9_ .:+/-]*[A-Za-z0-9_])?")
_IN_FILES = re.compile(r"[^A-Za-z0-9_.+ -]+")
# What a C comment may hold as it is. Left out beside what is not ASCII: the star (*/ ends a comment), the question mark
# (??/ is a backslash to a C99 compiler), the backslash and every line end (they join or begin lines).
_NOT_IN_COMMENTS = re.compile(r"[^A-Za-z0-9 _.,:;=+/()\[\]{}<>'\"^|&%#@!~$`-]")
_NOT_IN_MARKDOWN = re.compile(r"[^A-Za-z0-9 .,:;()/%°µ-]")


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


def in_comment(text: str) -> str:
    """Write any text so that a C or C++ compiler reads it as part of the comment around it, on one line."""
    return _NOT_IN_COMMENTS.sub(lambda found: f"<U+{ord(found.group()):04X}>", text)


def in_markdown(text: str) -> str:
    """Write any text so that Markdown, and the HTML that it lets through, shows it and does nothing else."""
    return _NOT_IN_MARKDOWN.sub(lambda found: f"&#{ord(found.group())};", text)
