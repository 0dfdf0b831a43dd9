"""What the checks of every kind of input share: verdicts, a limit of time, a folder, and an arm's files to corrupt.

A check takes one input. It returns "accepted" or "refused"; it raises where neither is the case.
"""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Literal, NamedTuple

from hypothesis.strategies import SearchStrategy

from moc_opt.errors import MocOptError

Verdict = Literal["accepted", "refused"]
SHORTEST = 15
"""Characters of a message that says something."""

ROBOTS = Path(__file__).resolve().parents[2] / "moc_opt" / "robots"
ARM_TOML = (ROBOTS / "lwr4.toml").read_text(encoding="utf-8").replace('"lwr4.urdf"', '"arm.urdf"')
ARM_URDF = (ROBOTS / "lwr4.urdf").read_text(encoding="utf-8")


class Kind(NamedTuple):
    """A kind of input: what must be true of each, and where they come from."""

    check: Callable[[Any], Verdict]
    cases: SearchStrategy[Any]


class Hang(BaseException):
    """A case took too long. No Exception: nothing may swallow it."""


class Wrong(AssertionError):
    """An input was taken, and what came of it is not true; or refused without saying why."""


@contextmanager
def time_limit(busy_s: float, wall_s: float) -> Iterator[None]:
    """Raise Hang where the inside takes longer.

    Args:
        busy_s: of the processor, by all threads of this process: what a busy machine does not lengthen.
        wall_s: by the clock, for what waits for ever.
    """

    def ring(number: int, frame: FrameType | None) -> None:
        raise Hang(f"more than {busy_s:g} s at work, or {wall_s:g} s by the clock")

    timers = {signal.SIGPROF: (signal.ITIMER_PROF, busy_s), signal.SIGALRM: (signal.ITIMER_REAL, wall_s)}
    before = {number: signal.signal(number, ring) for number in timers}
    for timer, seconds in timers.values():
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0.0)
            signal.signal(number, before[number])


def refused(error: MocOptError, named: bool = True) -> Verdict:
    """Return "refused" for an error that says what is wrong; ``named``: whether it names field or file.

    Raises:
        Wrong: it does not.
    """
    if not named:
        raise Wrong(f"what is wrong is not named: {error}") from error
    if len(str(error)) < SHORTEST:
        raise Wrong(f"says too little: {error}") from error
    return "refused"


@contextmanager
def folder() -> Iterator[Path]:
    """Make a folder for one case."""
    with tempfile.TemporaryDirectory(prefix="moc-opt-fuzz-") as name:
        yield Path(name)


@contextmanager
def file(name: str, data: bytes) -> Iterator[Path]:
    """Make a file for one case, alone in a folder."""
    with folder() as where:
        path = where / name
        path.write_bytes(data)
        yield path


@contextmanager
def arm(toml: str | bytes = ARM_TOML, urdf: str | bytes = ARM_URDF) -> Iterator[Path]:
    """Make the two files of an arm; yields the path of its TOML."""
    as_bytes = [part if isinstance(part, bytes) else part.encode() for part in (toml, urdf)]
    with file("arm.toml", as_bytes[0]) as path:
        path.with_suffix(".urdf").write_bytes(as_bytes[1])
        yield path
