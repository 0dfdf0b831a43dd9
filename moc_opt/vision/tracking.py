"""From single sightings of a board to a pose that can be trusted: smoothed, outliers refused, losses told."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from moc_opt.errors import TaskError
from moc_opt.tasks.checks import number
from moc_opt.vision.pose import Pose
from moc_opt.vision.settings import TrackerSettings


class TrackingState(Enum):
    """What is known of the board."""

    SEARCHING = "searching"
    """not seen yet"""
    TRACKING = "tracking"
    LOST = "lost"
    """seen before; the last pose is kept"""


@dataclass(frozen=True, eq=False)
class Sighting:
    """One picture's worth: where the board seemed to be, and how well that fits what was seen."""

    pose: Pose
    markers: int
    error_px: float
    """Root mean square distance of the markers' corners from where this pose puts them [px]."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """What the tracker says after a picture."""

    state: TrackingState
    pose: Pose | None
    """Smoothed pose; the last one while lost, None while searching."""
    refused: str | None
    """Why this picture's sighting was not taken; None if it was."""

    @property
    def seen(self) -> bool:
        """Whether the board is being tracked."""
        return self.state is TrackingState.TRACKING


class BoardTracker:
    """Follows a board from picture to picture.

    A board that rests is averaged over `smoothing_s`. One sighting far from the estimate is an outlier and
    changes nothing; several in a row that agree with each other are a board that was moved, and the estimate
    goes there at once: whoever uses it must not jump with it (see `WaitingReference`).
    """

    def __init__(self, limits: TrackerSettings | None = None) -> None:
        """Begin to search."""
        self.limits = TrackerSettings() if limits is None else limits
        self.state = TrackingState.SEARCHING
        self.pose: Pose | None = None
        self._time = -float("inf")
        self._last_seen = -float("inf")
        self._count = 0  # sightings in the estimate
        self._streak: list[Pose] = []  # of good sightings that are not in the estimate yet

    def update(self, t: float, sighting: Sighting | None) -> Tracked:
        """Take in one picture.

        Args:
            t: when it was taken [s], later than the one before.
            sighting: what was seen in it, None if nothing.

        Raises:
            TaskError: t is not finite or not later than the last picture.
        """
        now = number("t", t)
        if now <= self._time:
            raise TaskError(f"t = {t!r} s is not after the last picture at {self._time!r} s: keep their order")
        elapsed, self._time = now - self._time, now
        refused = self._refusal(sighting)
        if sighting is None or refused is not None:
            self._streak.clear()
        elif self.pose is not None and self.state is TrackingState.TRACKING and self._near(self.pose, sighting.pose):
            self._streak.clear()
            self.pose = self._blend(self.pose, sighting.pose, elapsed)
            self._last_seen = now
        else:
            refused = self._confirm(sighting.pose, now)
        if self.state is TrackingState.TRACKING and now - self._last_seen > self.limits.lost_after_s:
            self.state = TrackingState.LOST
        return Tracked(self.state, self.pose, refused)

    def _refusal(self, sighting: Sighting | None) -> str | None:
        """Return why the sighting by itself is not good enough."""
        if sighting is None:
            return "no marker seen"
        if sighting.markers < self.limits.min_markers:
            return f"{sighting.markers} markers seen, {self.limits.min_markers} needed"
        # Written so that a fit that is not a number is refused too.
        if not sighting.error_px <= self.limits.error_max_px:
            return f"fit {sighting.error_px:.2f} px, {self.limits.error_max_px:g} allowed"
        return None

    def _confirm(self, pose: Pose, now: float) -> str | None:
        """Collect good sightings until enough of them agree; returns why there is no pose yet."""
        if self._streak and not self._near(self._streak[-1], pose):
            self._streak.clear()
        self._streak.append(pose)
        if len(self._streak) < self.limits.found_after:
            far = self.state is TrackingState.TRACKING
            return "far from the estimate" if far else "waiting for more sightings that agree"
        # Back where it was, the long average goes on; elsewhere a new one begins.
        if self.pose is None or not self._near(self.pose, pose):
            mean, self._count = self._streak[0], 1
            for other in self._streak[1:]:
                mean = self._blend(mean, other, 0.0)
            self.pose = mean
        self._streak.clear()
        self.state, self._last_seen = TrackingState.TRACKING, now
        return None

    def _near(self, one: Pose, other: Pose) -> bool:
        way, turn = one.distance(other)
        return way <= self.limits.jump_m and turn <= self.limits.jump_rad

    def _blend(self, mean: Pose, pose: Pose, elapsed: float) -> Pose:
        """Return a plain mean at first, then an exponential one."""
        self._count += 1
        total = self.limits.smoothing_s + elapsed
        steady = elapsed / total if total > 0.0 else 1.0
        return mean.towards(pose, max(steady, 1.0 / self._count))
