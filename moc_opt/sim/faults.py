"""What can go wrong around the arm, seeded and as settings: sensors, packets, bumps, the trocar."""

from __future__ import annotations

from collections import deque
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moc_opt.errors import MocOptError, PlantError
from moc_opt.settings import Settings
from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement

Array = NDArray[np.float64]

GRAVITY = 9.81


class FaultSettings(Settings):
    """Everything is off by default. Times are counted from the start of the run."""

    KIND: ClassVar[str] = "[faults]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

    encoder_bias_rad: float = Field(
        default=0.0, ge=-0.1, le=0.1, description="on every joint, with seeded signs"
    )
    encoder_noise_rad: float = Field(
        default=0.0, ge=0.0, le=0.01, description="more noise, standard deviation"
    )
    drop_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="of the measurements that never arrive"
    )
    late_ticks: int = Field(default=0, ge=0, le=50, description="measurements arrive so much later")
    nan_at_s: float | None = Field(default=None, ge=0.0, description="the encoders say NaN from then on")
    nan_ticks: int = Field(default=1, ge=1, description="for so many ticks")
    jump_at_s: float | None = Field(
        default=None, ge=0.0, description="the encoders jump then, and stay there"
    )
    jump_rad: float = Field(default=0.2, description="by this much, on every joint")

    bump_N: float = Field(default=0.0, ge=0.0, le=200.0, description="sideways push on the elbow")
    bump_at_s: float = Field(default=2.0, ge=0.0)
    bump_s: float = Field(default=0.3, gt=0.0)
    bump_link: str = "link_4"
    payload_kg: float = Field(
        default=0.0, ge=0.0, le=10.0, description="weight hung on the tool, unknown to the model"
    )

    slip_m: float = Field(default=0.0, ge=0.0, le=0.1, description="the trocar slips sideways by this")
    slip_at_s: float = Field(default=2.0, ge=0.0)

    @property
    def any_sensor_fault(self) -> bool:
        """Whether measurements are touched at all."""
        harmless = (self.encoder_bias_rad, self.encoder_noise_rad, self.drop_share, self.late_ticks)
        return any(harmless) or self.nan_at_s is not None or self.jump_at_s is not None


class Faults:
    """The faults of one run: ``sense`` spoils measurements, ``act`` pushes, ``slip`` moves the trocar.

    Args:
        settings: what goes wrong.
        n: joints.
        period: control period [s].
        seed: of signs, noise, drops and directions.
    """

    def __init__(self, settings: FaultSettings, n: int, period: float, seed: int) -> None:
        self.settings, self._period = settings, period
        signs, noise, drops, directions = (
            np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)
        )
        self._bias = settings.encoder_bias_rad * signs.choice([-1.0, 1.0], size=n)
        self._noise, self._drops = noise, drops
        angle = directions.uniform(0.0, 2.0 * np.pi, size=2)
        self._bump = settings.bump_N * np.array([np.cos(angle[0]), np.sin(angle[0]), 0.0])
        self._slip = settings.slip_m * np.array([np.cos(angle[1]), np.sin(angle[1]), 0.0])
        self._past: deque[Measurement] = deque(maxlen=settings.late_ticks + 1)
        self._last: Measurement | None = None

    @property
    def any(self) -> bool:
        """Whether anything goes wrong at all: if not, nobody needs to be asked at every tick."""
        return self.settings != type(self.settings)()

    def sense(self, seen: Measurement, tick: int) -> Measurement:
        """What arrives of a measurement."""
        s, t = self.settings, tick * self._period
        q, v = seen.q + self._bias, seen.v
        if s.encoder_noise_rad > 0.0:
            q = q + self._noise.normal(scale=s.encoder_noise_rad, size=q.size)
        if s.jump_at_s is not None and t >= s.jump_at_s:
            q = q + s.jump_rad
        if s.nan_at_s is not None and s.nan_at_s <= t < s.nan_at_s + (s.nan_ticks - 0.5) * self._period:
            q = np.full_like(q, np.nan)
        self._past.append(Measurement(q, v, seen.force))
        arrived = self._past[0]
        if s.drop_share > 0.0 and self._last is not None and self._drops.uniform() < s.drop_share:
            arrived = self._last
        self._last = arrived
        return arrived

    def act(self, plant: Plant, tick: int) -> None:
        """Begin and end the pushes that fall on this tick."""
        s, t, half = self.settings, tick * self._period, 0.5 * self._period
        if s.payload_kg > 0.0 and tick == 0:
            plant.push("tool", [0.0, 0.0, -s.payload_kg * GRAVITY])
        if s.bump_N > 0.0:
            if abs(t - s.bump_at_s) < half:
                plant.push(s.bump_link, self._bump)
            elif abs(t - s.bump_at_s - s.bump_s) < half:
                plant.clear_pushes(s.bump_link)

    def slip(self, trocars: Array, times: Array) -> Array:
        """The true trocar (N, 2, 3) with its slip: a smooth step of 0.1 s."""
        if self.settings.slip_m == 0.0:
            return trocars
        u = np.clip((times - self.settings.slip_at_s) / 0.1, 0.0, 1.0)
        moved = np.array(trocars)
        moved[:, 0] += np.outer(u * u * (3.0 - 2.0 * u), self._slip)
        moved[:, 1] += np.outer(6.0 * u * (1.0 - u) / 0.1, self._slip)
        return moved
