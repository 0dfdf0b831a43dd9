"""Numbers of a URDF, read in one strict way: what one reader takes and another one drops makes two different arms."""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree.ElementTree import Element

from moc_opt.errors import RobotError

_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_BLANKS = " \t\r\n"
"""White space as XML has it; other blanks of Unicode are none to most readers."""
_BLANK = re.compile(f"[{_BLANKS}]+")
_LONGEST = 60
SMALLEST = 1e-30
"""A number nearer to zero is one of rounding errors, or hostile; some readers refuse those below 1e-308 unheard."""
LARGEST: Mapping[str, float] = {
    "m": 100.0, "rad": 100.0, "kg": 1e5, "kg m^2": 1e6, "1": 1e3, "a limit": 1e6,
}  # fmt: skip
"""Unit -> the largest size of a number of it that an arm can have."""


def is_decimal(text: str) -> bool:
    """Say whether a text is one decimal number: ASCII digits with a point, a sign and an exponent where wanted.

    One too large for a double is decimal too: `float` reads it as infinite, and every limit refuses it by its size.
    """
    text = text.strip(_BLANKS)
    return len(text) <= _LONGEST and _DECIMAL.fullmatch(text) is not None


def number(text: str, what: str, unit: str) -> float:
    """Read one decimal number.

    Args:
        text: see `is_decimal`; no hexadecimal, no underscores, no words.
        what: it is, for the message: "mass of link 'link_1'".
        unit: a key of `LARGEST`.

    Raises:
        RobotError: anything else, or a size that no arm has.
    """
    text = text.strip(_BLANKS)
    if not is_decimal(text):
        raise RobotError(f"urdf: {what} is {text!r:.80}: write a finite decimal number, such as 0.25 or -1e-3")
    value = float(text)
    zero = not any(digit in "123456789" for digit in text.lower().partition("e")[0])  # as it is written
    if abs(value) > LARGEST[unit] or (abs(value) < SMALLEST and not zero):
        raise RobotError(f"urdf: {what} is {text!r}: give 0 or a size from {SMALLEST:g} to {LARGEST[unit]:g} ({unit})")
    return value


def triple(element: Element | None, key: str, what: str, unit: str) -> tuple[float, float, float]:
    """Read three decimal numbers from an attribute; zeros where element or attribute is missing.

    Raises:
        RobotError: another count, or a number that `number` refuses.
    """
    if element is None or key not in element.attrib:
        return (0.0, 0.0, 0.0)
    text = element.get(key, "")
    parts = [part for part in _BLANK.split(text) if part]
    if len(parts) != 3:
        raise RobotError(f"urdf: {what} is {text!r:.80}: write three numbers, such as '0 0 0.1'; it has {len(parts)}")
    x, y, z = (number(part, what, unit) for part in parts)
    return (x, y, z)


def as_text(*values: float) -> str:
    """Write numbers so that every reader gets them back to the bit."""
    return " ".join(repr(float(value)) for value in values)
