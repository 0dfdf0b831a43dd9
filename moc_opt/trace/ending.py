"""How a run ended: the first word of ``meta["ended"]``, and its consequences."""

from __future__ import annotations

from enum import StrEnum


class Ending(StrEnum):
    """The ways in which a run ends; the reason follows the word, as in "stopped: the tip ..."."""

    COMPLETED = "completed"
    OSCILLATED = "oscillated"
    STOPPED = "stopped"
    RAN_AWAY = "ran away"
    FAILED = "failed"
    PART = "part"
    """Some of the ticks of a run; the text after it is the run's ending."""

    @classmethod
    def of(cls, ended: str) -> Ending:
        """Read the ending from the text of ``meta["ended"]``; a text that begins with none of the words is FAILED."""
        return next((ending for ending in cls if ended.startswith(ending.value)), cls.FAILED)

    @property
    def whole(self) -> bool:
        """Whether the task was driven to its end: only then do the run's figures enter a mean.

        A run that oscillated was, and is counted beside the means.
        """
        return self in (Ending.COMPLETED, Ending.OSCILLATED)
