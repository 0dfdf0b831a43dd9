"""Faults, seeded and as settings: of sensors, packets, bumps, the trocar, the solver."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Name
from moc_opt.numerics.arrays import Array
from moc_opt.sim.mjcf import TOOL_BODY
from moc_opt.sim.packets import Packets, PacketSettings
from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement

GRAVITY = 9.81


class FaultSettings(PacketSettings):
    """Faults to inject; all are off by default. Times count from the start of the run."""

    KIND: ClassVar[str] = "[faults]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

    encoder_bias_rad: float = Field(
        default=0.0, ge=-0.1, le=0.1, description="constant error of every encoder, with seeded signs"
    )
    encoder_noise_rad: float = Field(default=0.0, ge=0.0, le=0.01, description="standard deviation of additional noise")
    nan_at_s: float | None = Field(default=None, ge=0.0, description="time from which the encoders give NaN")
    nan_ticks: int = Field(default=1, ge=1, description="ticks for which they do")
    jump_at_s: float | None = Field(
        default=None, ge=0.0, description="time at which the encoders jump; they do not jump back"
    )
    jump_rad: float = Field(default=0.2, description="size of the jump, on every joint")

    bump_N: float = Field(default=0.0, ge=0.0, le=200.0, description="force of a sideways push on the elbow")
    bump_at_s: float = Field(default=2.0, ge=0.0, description="time at which the push begins")
    bump_s: float = Field(default=0.3, gt=0.0, description="duration of the push")
    bump_link: Name = Field(default="link_4", description="the link that is pushed")
    payload_kg: float = Field(default=0.0, ge=0.0, le=10.0, description="weight hung on the tool, unknown to the model")

    slip_m: float = Field(default=0.0, ge=0.0, le=0.1, description="distance by which the trocar slips sideways")
    slip_at_s: float = Field(default=2.0, ge=0.0, description="time at which the trocar slips")

    solver: Literal["none", "fail", "nan", "lie", "raise", "outside", "rig", "malformed", "hang"] = Field(
        default="none",
        description="how the solver's answers are corrupted (moc_opt.solvers.faulty); 'hang' takes ten times the "
        "budget",
    )
    solver_share: float = Field(default=0.05, ge=0.0, le=1.0, description="share of the answers that are corrupted")

    @property
    def around_the_arm(self) -> bool:
        """Whether anything but the solver is disturbed: if not, the loop need not ask at every tick."""
        solver = {"solver", "solver_share"}
        return any(getattr(self, k) != f.default for k, f in type(self).model_fields.items() if k not in solver)


class Faults:
    """The faults of one run: ``sense`` corrupts measurements, ``act`` pushes, ``slip`` moves the trocar.

    Args:
        settings: the faults.
        n: joints.
        period: control period [s].
        seed: of signs, noise, drops and directions.
    """

    def __init__(self, settings: FaultSettings, n: int, period: float, seed: int) -> None:
        self.settings, self._period = settings, period
        signs, noise, drops, directions, drifts = (
            np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)
        )
        self._bias = settings.encoder_bias_rad * signs.choice([-1.0, 1.0], size=n)
        self._noise, self._packets = noise, Packets(settings, n, period, drops, drifts)
        angle = directions.uniform(0.0, 2.0 * np.pi, size=2)
        self._bump = settings.bump_N * np.array([np.cos(angle[0]), np.sin(angle[0]), 0.0])
        self._weight = np.array([0.0, 0.0, -settings.payload_kg * GRAVITY])
        self._slip = settings.slip_m * np.array([np.cos(angle[1]), np.sin(angle[1]), 0.0])
        self._bump_on = round(settings.bump_at_s / period)
        self._bump_off = self._bump_on + max(1, round(settings.bump_s / period))

    def sense(self, seen: Measurement, tick: int) -> Measurement:
        """Return the measurement with its faults, as it arrives."""
        s, t = self.settings, tick * self._period
        q, v = seen.q + self._bias, seen.v
        if s.encoder_noise_rad > 0.0:
            q = q + self._noise.normal(scale=s.encoder_noise_rad, size=q.size)
        if s.jump_at_s is not None and t >= s.jump_at_s:
            q = q + s.jump_rad
        if s.nan_at_s is not None and 0 <= tick - round(s.nan_at_s / self._period) < s.nan_ticks:
            q = np.full_like(q, np.nan)
        return self._packets.arrive(seen._replace(q=q, v=v), tick)

    def act(self, plant: Plant, tick: int) -> None:
        """Begin and end the pushes that fall on this tick."""
        s = self.settings
        if s.payload_kg > 0.0 and tick == 0:
            plant.push(TOOL_BODY, self._weight)
        if s.bump_N > 0.0 and tick in (self._bump_on, self._bump_off):
            held = self._weight if s.bump_link == TOOL_BODY else np.zeros(3)
            plant.push(s.bump_link, held + self._bump * (tick == self._bump_on))

    def slip(self, trocars: Array, times: Array) -> Array:
        """Return the true trocar (N, 2, 3) with its slip: a smooth step of 0.1 s."""
        if self.settings.slip_m == 0.0:
            return trocars
        u = np.clip((times - self.settings.slip_at_s) / 0.1, 0.0, 1.0)
        moved = np.array(trocars)
        moved[:, 0] += np.outer(u * u * (3.0 - 2.0 * u), self._slip)
        moved[:, 1] += np.outer(6.0 * u * (1.0 - u) / 0.1, self._slip)
        return moved
