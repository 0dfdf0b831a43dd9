"""The errors that a user can meet. Each message names the field, the value and the cure."""

from __future__ import annotations

import contextlib
import difflib
import re
from collections.abc import Iterable, Iterator
from numbers import Real
from pathlib import Path
from traceback import walk_tb
from typing import ClassVar


class MocOptError(Exception):
    """Base of every error that moc_opt raises on purpose."""

    MOST: ClassVar[int] = 2000

    def __str__(self) -> str:
        text = super().__str__()
        return text if len(text) <= self.MOST else text[: self.MOST - 3] + "..."


class SubproblemError(MocOptError, ValueError):
    """The data of a null-space subproblem are not usable."""


class RobotError(MocOptError, ValueError):
    """A robot description is missing, incomplete or inconsistent."""


class TaskError(MocOptError, ValueError):
    """A path, time law or trocar cannot be built from these numbers."""


class ControlError(MocOptError, ValueError):
    """A controller setting is not usable."""


class PlantError(MocOptError, ValueError):
    """A plant, sensor or contact setting is not usable."""


class SolverError(MocOptError, ValueError):
    """A solver cannot be built or run with these settings on this machine."""


class ScenarioError(MocOptError, ValueError):
    """A scenario file or field is not usable."""


class TraceError(MocOptError, ValueError):
    """A trace file or its columns are not usable."""


class StudyError(MocOptError, RuntimeError):
    """A study cannot go on."""


class ReportError(MocOptError, ValueError):
    """A table, figure or page cannot be made or written."""


class BrowserError(ReportError):
    """A browser cannot be controlled on this machine."""


class BrowserMissingError(BrowserError):
    """There is no browser, or no package that controls a browser."""


class UnknownNameError(MocOptError, LookupError):
    """A name is not known. The message suggests similar names. It lists all valid names, or refers to a command."""

    MOST = 10_000  # the message may list many names
    FEW: ClassVar[int] = 12  #: With more names, the message refers to the command ``listed_by``.

    def __init__(self, kind: str, name: str, valid: Iterable[str], listed_by: str = "") -> None:
        """``listed_by`` is a command that lists the ``valid`` names."""
        names = sorted(valid)
        short = bool(listed_by) and len(names) > self.FEW
        # A name of one part is compared with the last part of each name, such as `osqp` of `qpsolvers:osqp`.
        ends = {one: (one if {".", ":"} & set(name) else re.split("[.:]", one)[-1]).lower() for one in names}
        close = difflib.get_close_matches(name[:100].lower(), set(ends.values()), n=3, cutoff=0.55)
        near = [one for end in close for one in names if ends[one] == end][:3]
        hint = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
        every = f"`{listed_by}` lists all {len(names)}" if short else f"valid names: {', '.join(names)}"
        super().__init__(f"unknown {kind} {shown(name)}: {hint}{every}")
        self.kind, self.name, self.valid = kind, name, names


@contextlib.contextmanager
def named(where: object) -> Iterator[None]:
    """Put ``where``, such as a file or table, before the message of a MocOptError raised inside."""
    try:
        yield
    except MocOptError as error:
        error.args = (f"{where} {error}",)  # keeps the class of the error
        raise


def is_number(value: object) -> bool:
    """Return whether a value is a real number, not a bool, and not too large for a float."""
    fits = not isinstance(value, int) or abs(value) < 2**1023
    return isinstance(value, Real) and not isinstance(value, bool) and fits


def shown(value: object, most: int = 200) -> str:
    """Return the text of a value in a message, cut at ``most`` characters."""
    try:
        text = repr(value)
    except Exception as reason:  # noqa: BLE001 - repr of a user's class may raise anything; repr of huge integers fails
        text = f"({type(value).__name__} that cannot be written: {type(reason).__name__})"
    return text if len(text) <= most else text[: most - 3] + "..."


def describe(error: BaseException, most: int = 300) -> str:
    """Return type and text of an exception in one line of at most ``most`` characters."""
    name = type(error).__name__
    try:
        said = " ".join(str(error).split())
    except (Exception, SystemExit) as worse:  # noqa: BLE001 - str(error) of a plug-in may raise anything
        said = f"(its text raised {type(worse).__name__})"
    text = f"{name}: {said}" if said else name
    return printable(text if len(text) <= most else text[: most - 3] + "...")


def located(error: BaseException) -> str:
    """Return `describe(error)` and, of the first file outside moc_opt, the innermost line: " (mine.py, line 12)"."""
    lines = {
        frame.f_code.co_filename: line for frame, line in walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__")).partition(".")[0] != "moc_opt"
    }  # fmt: skip
    file = next((name for name in lines if not name.startswith("<")), "")  # "<string>": generated by dataclass
    return describe(error) + (f" ({printable(Path(file).name)}, line {lines[file]})" if file else "")


def printable(text: str) -> str:
    """Replace characters that could control a terminal."""
    return "".join(c if c.isprintable() else "\ufffd" for c in text)
