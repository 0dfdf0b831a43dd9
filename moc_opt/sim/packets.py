"""Faults between the encoders and the controller: frozen, late, repeated and drifting measurements.

Each packet carries the number of the control period in which it was taken. A sensor or a buffer may give a wrong one
(``forged_stamps``): old readings then come with numbers that are up to date.
"""

from __future__ import annotations

from collections import deque
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Settings
from moc_opt.sim.sensors import Measurement


class PacketSettings(Settings):
    """Faults of measurements in time. Everything is off by default; times count from the start of the run."""

    KIND: ClassVar[str] = "[faults]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

    drop_share: float = Field(default=0.0, ge=0.0, le=1.0, description="share of the measurements that never arrive")
    late_ticks: int = Field(default=0, ge=0, le=50, description="ticks by which every measurement arrives late")
    frozen_at_s: float | None = Field(default=None, ge=0.0, description="time from which readings repeat themselves")
    frozen_ticks: int = Field(default=1_000_000, ge=1, description="ticks for which they do")
    frozen_joint: int | None = Field(
        default=None, ge=0,
        description="freeze one encoder only, counted from 0, while its packets go on; None: whole packets",
    )  # fmt: skip
    frozen_wrench: bool = Field(
        default=False, description="freeze the wrench sensor only, while the encoders' packets go on"
    )
    frozen_velocity: Literal["repeated", "zero"] = Field(default="repeated", description="velocity in a frozen reading")
    lag_at_s: float | None = Field(default=None, ge=0.0, description="time from which measurements lag more and more")
    lag_joint: int | None = Field(
        default=None, ge=0,
        description="let one encoder only lag, counted from 0, under up-to-date packet numbers; None: all lag",
    )  # fmt: skip
    lag_ticks: int = Field(default=0, ge=0, le=1000, description="ticks of delay added at once at lag_at_s")
    lag_growth: float = Field(default=0.1, gt=0.0, le=1.0, description="ticks of delay added in each tick")
    replay_at_s: float | None = Field(
        default=None, ge=0.0, description="time from which old packets arrive again, in their order, over and over"
    )
    replay_ticks: int = Field(
        default=100, ge=1, le=5000, description="number of packets that are replayed: the last ones before replay_at_s"
    )
    drift_at_s: float = Field(default=0.0, ge=0.0, description="time at which the drift begins")
    drift_rad_per_s: float = Field(
        default=0.0, ge=-1.0, le=1.0, description="speed of the encoders' drift, in seeded directions"
    )
    drift_velocity: Literal["included", "apart"] = Field(
        default="included",
        description="'included': the velocity drifts as well; 'apart': it is measured separately and does not",
    )
    forged_stamps: bool = Field(
        default=False, description="whether frozen, replayed and lagging packets carry the number of the present period"
    )


class Packets:
    """The faults of one run's packets.

    Args:
        settings: the faults.
        n: joints.
        period: control period [s].
        drops: draws the packets that are lost.
        signs: draws the directions of the drift.

    Raises:
        PlantError: a joint that the arm does not have.
    """

    def __init__(
        self, settings: PacketSettings, n: int, period: float, drops: np.random.Generator, signs: np.random.Generator
    ) -> None:
        self.settings, self._period, self._drops = settings, period, drops
        s = settings
        lag = 0 if s.lag_at_s is None else 2000
        back = 0 if s.replay_at_s is None else s.replay_ticks
        self._past: deque[Measurement] = deque(maxlen=max(s.late_ticks + lag, back) + 1)
        for name in ("frozen_joint", "lag_joint"):
            joint = getattr(s, name)
            if joint is not None and joint >= n:
                raise PlantError(f"{name} = {joint}: the arm has {n} joints: give 0 to {n - 1}")
        self._drift = s.drift_rad_per_s * signs.choice([-1.0, 1.0], size=n)
        self._last: Measurement | None = None
        self._frozen: Measurement | None = None
        self._tape: list[Measurement] = []

    def arrive(self, taken: Measurement, tick: int) -> Measurement:
        """Return the measurement that arrives at this tick; ``taken`` is the sensors' own."""
        s = self.settings
        since = tick * self._period - s.drift_at_s
        if s.drift_rad_per_s != 0.0 and since > 0.0:
            v = taken.v + self._drift if s.drift_velocity == "included" else taken.v
            taken = taken._replace(q=taken.q + since * self._drift, v=v)
        self._past.append(taken)
        lagging = self._after(s.lag_at_s, tick)
        late = s.late_ticks + int(s.lag_growth * lagging + 1e-9) + (s.lag_ticks if lagging else 0)
        arrived = self._past[max(0, len(self._past) - 1 - late)]
        if late > s.late_ticks:
            on_time = self._past[max(0, len(self._past) - 1 - s.late_ticks)]
            arrived = self._forged(arrived, taken) if s.lag_joint is None else _spliced(on_time, arrived, s.lag_joint)
        arrived = self._replayed(self._stuck(arrived, taken, tick), taken, tick)
        if s.drop_share > 0.0 and self._last is not None and self._drops.uniform() < s.drop_share:
            arrived = self._last
        self._last = arrived
        return arrived

    def _after(self, at_s: float | None, tick: int) -> int:
        """Return ticks since a fault began, the first one counted; 0 before."""
        return 0 if at_s is None else max(0, tick - round(at_s / self._period) + 1)

    def _forged(self, arrived: Measurement, taken: Measurement) -> Measurement:
        return arrived._replace(stamp=taken.stamp) if self.settings.forged_stamps else arrived

    def _stuck(self, arrived: Measurement, taken: Measurement, tick: int) -> Measurement:
        s = self.settings
        if not 0 < self._after(s.frozen_at_s, tick) <= s.frozen_ticks:
            self._frozen = None
            return arrived
        held = self._frozen = self._frozen or self._last or arrived
        v = np.zeros_like(held.v) if s.frozen_velocity == "zero" else held.v
        if s.frozen_wrench:
            return arrived._replace(force=held.force)
        if s.frozen_joint is None:
            return self._forged(held._replace(v=v), taken)
        return _spliced(arrived, held._replace(v=v), s.frozen_joint)

    def _replayed(self, arrived: Measurement, taken: Measurement, tick: int) -> Measurement:
        s = self.settings
        after = self._after(s.replay_at_s, tick)
        if after == 0:
            return arrived
        if after == 1:
            self._tape = list(self._past)[-s.replay_ticks :]
        return self._forged(self._tape[(after - 1) % len(self._tape)], taken)


def _spliced(arrived: Measurement, other: Measurement, joint: int) -> Measurement:
    """Return what arrived, with one encoder's reading of another measurement."""
    q, v = np.array(arrived.q), np.array(arrived.v)
    q[joint], v[joint] = other.q[joint], other.v[joint]
    return arrived._replace(q=q, v=v)
