"""Write numbers, units and missing values as text."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

from moc_opt.errors import is_number

NARROW_SPACE, INFINITY, DASH = "\u202f", "\u221e", "\u2013"

RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


@dataclass(frozen=True)
class Missing:
    """A missing value, with the reason."""

    reason: str = "no value"


@dataclass(frozen=True)
class Mark:
    """A rating in a table.

    Attributes:
        symbol: one character, or none.
        tone: "best", "good", "fair", "bad" or "other".
        rank: key for sorting; the best rating has the lowest rank.
    """

    symbol: str
    word: str
    tone: str
    rank: int = 0


@dataclass(frozen=True)
class Notation:
    """How the numbers of one column are written.

    Attributes:
        digits: number of significant digits.
        spec: Python's format specification, which overrides the other attributes.
        scientific: write powers of ten.
        integral: every number is an integer.
    """

    digits: int = 3
    spec: str = ""
    scientific: bool = False
    integral: bool = False

    @classmethod
    def of(cls, values: Iterable[object], digits: int = 3, spec: str = "") -> Notation:
        """Choose the notation of a column."""
        numbers = [float(value) for value in values if is_number(value)]  # type: ignore[arg-type]
        sizes = [abs(number) for number in numbers if math.isfinite(number)]
        integral = bool(sizes) and all(size.is_integer() for size in sizes) and max(sizes) < 1e12
        wide = any(0.0 < size < 1e-4 or size >= 1e6 for size in sizes)
        return cls(digits, spec, scientific=wide and not integral, integral=integral)

    def __call__(self, value: float) -> str:
        """Write one number for a terminal."""
        number = float(value)
        if math.isinf(number):
            return INFINITY if number > 0 else "-" + INFINITY
        if self.spec:
            written = format(round(number) if self.spec.endswith("d") else number, self.spec)
            return _tidy(written) if "e" in written else written
        if self.integral:
            return f"{round(number):_}".replace("_", NARROW_SPACE) if abs(number) >= 10_000 else f"{round(number)}"
        if number == 0.0:
            return "0"
        rounded = f"{number:.{self.digits - 1}e}"
        if self.scientific:
            return _tidy(rounded)
        return f"{number:.{max(0, self.digits - 1 - int(rounded.split('e')[1]))}f}"


def _tidy(written: str) -> str:
    """Return 5.4e-07 as 5.4e-7, and 0.0e+00 as 0."""
    mantissa, exponent = written.split("e")
    return f"{mantissa}e{int(exponent)}" if float(mantissa) else "0"


def missing(value: object) -> Missing | None:
    """Return why a value is missing; None if there is a value."""
    if isinstance(value, Missing):
        return value
    if value is None or (is_number(value) and math.isnan(float(value))):  # type: ignore[arg-type]
        return Missing()
    return None


def fraction_length(text: str) -> int:
    """Return the number of characters from the decimal point to the end."""
    return len(text) - text.index(".") if "." in text and "e" not in text else 0


def pretty_unit(unit: str) -> str:
    """Write m^3 as m³ and us as µs."""
    raised = re.sub(r"\^(-?\d+)", lambda match: match[1].translate(RAISED), printable(unit))
    return re.sub(r"\bus\b", "µs", raised)


def pretty_units(text: str) -> str:
    """Apply `pretty_unit` to the units in [brackets]."""
    return re.sub(r"\[([^\]]*)\]", lambda match: f"[{pretty_unit(match[1])}]", text)


def pretty_power(power: int) -> str:
    """Return a power of ten for an axis: 1, 10, 10⁻³."""
    return {0: "1", 1: "10"}.get(power, f"10{str(power).translate(RAISED)}")


def printable(text: str) -> str:
    """Replace characters that control a terminal or the direction of text."""
    return "".join(c if c == "\n" or unicodedata.category(c) not in ("Cc", "Cf", "Cs") else "\ufffd" for c in text)
