"""The plant's actions while no commands arrive: hold, then carry the weight and damp, then brake."""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.realtime.settings import WireSettings
from moc_opt.sim.protocols import SafetyFilter
from moc_opt.sim.sensors import Measurement


class Watchdog:
    """Counts ticks without a command, and says which torque takes its place.

    The last torque is held for ``hold_ticks``. For ``damp_ticks`` more the drives carry the arm's weight and damp its
    motion; a command in that time is followed again. Then the brakes close, and nothing opens them.

    Args:
        settings: see ``WireSettings``.
        safety_filter: knows the arm's weight and its brakes; the plant's own, not the controller's.
        first: the measurement at which the run begins.
    """

    def __init__(self, settings: WireSettings, safety_filter: SafetyFilter, first: Measurement) -> None:
        self._settings, self._filter, self._sound = settings, safety_filter, first
        self.missed = 0
        self.reason = ""

    def see(self, seen: Measurement) -> None:
        """Take note of a measurement; one that is not finite is passed over."""
        if np.isfinite(seen.q).all() and np.isfinite(seen.v).all():
            self._sound = seen

    def feed(self) -> None:
        """Note that a command has come."""
        self.missed = 0

    def tick(self, applied: Array) -> Array:
        """Return the torque (n,) [Nm] of a tick without a command, where ``applied`` (n,) acted in the last one."""
        self.missed += 1
        past = self.missed - self._settings.hold_ticks
        if self.reason:
            return self._filter.stop_torque(applied)
        if past <= 0:
            return applied
        sound = self._sound
        self._filter.start(sound.q, sound.v, sound.stamp)  # the weight is that of this pose
        if past <= self._settings.damp_ticks:
            return self._filter.stop_torque(applied) - self._settings.damping_Nm_s_per_rad * sound.v
        self.reason = f"no command from the controller for {self.missed} ticks"
        self._filter.request_stop(self.reason)
        return self._filter.stop_torque(applied)

    def brake_friction(self) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes, once a tick."""
        return self._filter.brake_friction(self._sound.force)
