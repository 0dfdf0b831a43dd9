"""One place of the trocar or of the arm's base, and the best course along the path from there."""

from __future__ import annotations

from dataclasses import dataclass

from moc_opt.errors import ScenarioError
from moc_opt.planning.course import Course


@dataclass(frozen=True, eq=False)
class Placement:
    """One place of trocar or base.

    Example:
        >>> from moc_opt.scenario.placement import place
        >>> first = place(mo.Scenario(duration_s=1.0), "trocar", candidates=2, best=1)[0]
        >>> sorted(first.changes())
        ['start', 'trocar']
    """

    shift_m: tuple[float, float, float]
    """From where the scenario has it, in the world [m]."""
    course: Course | None
    """The best over all swivels and branches at the start; None: the path cannot be executed."""
    depth_m: float
    """Of the tip below the trocar at the start [m]."""

    def changes(self) -> dict[str, object]:
        """Return what a scenario needs to begin there: ``scenario.change(**placement.changes())``.

        Raises:
            ScenarioError: the path cannot be executed.
        """
        if self.course is None:
            raise ScenarioError(f"shift_m = {self.shift_m}: the path cannot be executed there; take another place")
        start = {"pose": "home", "q_rad": tuple(self.course.q_rad[0].tolist()), "swivel": "given"}
        return {"start": start, "trocar": {"depth_m": self.depth_m}}
