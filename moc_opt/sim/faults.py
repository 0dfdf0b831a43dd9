"""Faults of sensors, packets, trocar and solver, and pushes on the arm."""

from __future__ import annotations

from collections import deque
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, PlantError
from moc_opt.inputs.settings import Name, Settings
from moc_opt.sim.mjcf import TOOL_BODY
from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement

GRAVITY = 9.81


class FaultSettings(Settings):
    """Faults that are put into the run. All are off by default. A fault at a time after the run has no effect."""

    KIND: ClassVar[str] = "[faults]"
    ERROR: ClassVar[type[MocOptError]] = PlantError

    drop_share: float = Field(0.0, ge=0.0, le=1.0, description="share of the measurements that never arrive")
    late_ticks: int = Field(0, ge=0, le=50, description="delay of every measurement")
    frozen_at_s: float | None = Field(None, ge=0.0)
    """time at which readings freeze. By default, they never freeze"""
    frozen_ticks: int = Field(1_000_000, ge=1, description="number of control periods for which readings stay frozen")
    frozen_joint: int | None = Field(None, ge=0)
    """index (from 0) of the only encoder that freezes. If left out, all sensors freeze"""
    frozen_wrench: bool = Field(False, description="whether only the wrench sensor freezes, and no encoder")
    frozen_velocity: Literal["repeated", "zero"] = "repeated"
    """velocity in a frozen reading. 'repeated': the last velocity; 'zero': 0"""
    lag_at_s: float | None = Field(None, ge=0.0)
    """time from which measurements lag. By default, they never lag"""
    lag_joint: int | None = Field(None, ge=0)
    """index (from 0) of the only encoder that lags. If left out, all sensors lag"""
    lag_ticks: int = Field(0, ge=0, le=1000, description="lag at the time `lag_at_s`, added to `late_ticks`")
    lag_growth: float = Field(0.1, gt=0.0, le=1.0)
    """number of control periods by which the lag grows in each control period after `lag_at_s`"""
    replay_at_s: float | None = Field(None, ge=0.0)
    """time from which old measurements arrive again in a loop. By default, none arrives again"""
    replay_ticks: int = Field(100, ge=1, le=5000)
    """number of measurements before `replay_at_s` that arrive again"""
    drift_at_s: float = Field(0.0, ge=0.0, description="time at which the encoders begin to drift")
    drift_rad_per_s: float = Field(0.0, ge=-1.0, le=1.0)
    """speed at which the encoders drift, each with a random sign"""
    drift_velocity: Literal["included", "apart"] = "included"
    """measured velocities while the positions drift. 'included': with the speed of the drift; 'apart': without it"""
    forged_stamps: bool = False
    """whether frozen, replayed and lagging measurements carry the time stamps of new ones"""
    encoder_bias_rad: float = Field(0.0, ge=-0.1, le=0.1)
    """constant error of the encoders, each with a random sign"""
    encoder_noise_rad: float = Field(0.0, ge=0.0, le=0.01, description="standard deviation of additional encoder noise")
    nan_at_s: float | None = Field(None, ge=0.0)
    """time from which encoders give NaN. By default, they never do"""
    nan_ticks: int = Field(1, ge=1, description="number of control periods for which encoders give NaN")
    jump_at_s: float | None = Field(None, ge=0.0)
    """time at which all encoders jump and stay displaced. By default, they never jump"""
    jump_rad: float = Field(0.2, description="size of the encoders' jump at the time `jump_at_s`")

    bump_N: float = Field(0.0, ge=0.0, le=200.0, description="force of a horizontal push on the link `bump_link`")
    bump_at_s: float = Field(2.0, ge=0.0, description="time at which the push on `bump_link` begins")
    bump_s: float = Field(0.3, gt=0.0, description="duration of the push on `bump_link`")
    bump_link: Name = Field("link_4", description="name of the link that is pushed with the force `bump_N`")
    payload_kg: float = Field(0.0, ge=0.0, le=10.0)
    """mass that hangs on the tool, unknown to the controller"""

    slip_m: float = Field(0.0, ge=0.0, le=0.1, description="distance by which the trocar slips horizontally")
    slip_at_s: float = Field(2.0, ge=0.0, description="time at which the trocar slips")
    solver: Literal["none", "fail", "nan", "lie", "raise", "outside", "rig", "malformed", "hang"] = "none"
    """fault of the solver's answers, without effect if `law` = 'dcac'. 'fail': no answer; 'nan': NaN; 'lie': optimum
    for the negated manipulability gradient; 'raise': exception; 'outside': outside the bounds; 'rig': wrong answer, and
    the solver changes the problem to fit it; 'malformed': wrong data type; 'hang': solve time of ten times
    `budget_us`, or of ten times `deadline_us` if there is no `budget_us`"""
    solver_share: float = Field(0.05, ge=0.0, le=1.0)
    """share of the solver's answers that have the fault `solver`"""

    @property
    def around_the_arm(self) -> bool:
        """Whether any setting except ``solver`` and ``solver_share`` differs from its default."""
        solver = {"solver", "solver_share"}
        return any(getattr(self, k) != f.default for k, f in type(self).model_fields.items() if k not in solver)


class Faults:
    """The faults of one run, for an arm of ``n`` joints and a control ``period`` [s].

    Raises:
        PlantError: ``frozen_joint`` or ``lag_joint`` is no joint of the arm.
    """

    def __init__(self, settings: FaultSettings, n: int, period: float, seed: int) -> None:
        self.settings = s = settings
        self._period = period
        for name in ("frozen_joint", "lag_joint"):
            joint = getattr(s, name)
            if joint is not None and joint >= n:
                raise PlantError(f"{name} = {joint}: the arm has {n} joints; give 0 to {n - 1}")
        signs, self._noise, self._drops, directions, drifts = (
            np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)
        )
        self._bias = s.encoder_bias_rad * signs.choice([-1.0, 1.0], size=n)
        self._drift = s.drift_rad_per_s * drifts.choice([-1.0, 1.0], size=n)
        angle = directions.uniform(0.0, 2.0 * np.pi, size=2)
        self._bump = s.bump_N * np.array([np.cos(angle[0]), np.sin(angle[0]), 0.0])
        self._weight = np.array([0.0, 0.0, -s.payload_kg * GRAVITY])
        self._slip = s.slip_m * np.array([np.cos(angle[1]), np.sin(angle[1]), 0.0])
        self._bump_on = round(s.bump_at_s / period)
        self._bump_off = self._bump_on + max(1, round(s.bump_s / period))
        most_late = s.late_ticks + (0 if s.lag_at_s is None else 2000)
        most_old = 0 if s.replay_at_s is None else s.replay_ticks
        self._past: deque[Measurement] = deque(maxlen=max(most_late, most_old) + 1)
        self._last: Measurement | None = None
        self._frozen: Measurement | None = None
        self._tape: list[Measurement] = []

    def act(self, plant: Plant, tick: int) -> None:
        """Begin or end the pushes that are due at ``tick``."""
        s = self.settings
        if s.payload_kg > 0.0 and tick == 0:
            plant.push(TOOL_BODY, self._weight)
        if s.bump_N > 0.0 and tick in (self._bump_on, self._bump_off):
            held = self._weight if s.bump_link == TOOL_BODY else np.zeros(3)
            plant.push(s.bump_link, held + self._bump * (tick == self._bump_on))

    def slip(self, trocars: Array, times: Array) -> Array:
        """Add the slip to ``trocars`` (N, 2, 3), rows P_t and dP_t, at ``times`` (N,) [s]."""
        if self.settings.slip_m == 0.0:
            return trocars
        u = np.clip((times - self.settings.slip_at_s) / 0.1, 0.0, 1.0)
        moved = np.array(trocars)
        moved[:, 0] += np.outer(u * u * (3.0 - 2.0 * u), self._slip)
        moved[:, 1] += np.outer(6.0 * u * (1.0 - u) / 0.1, self._slip)
        return moved

    def sense(self, seen: Measurement, tick: int) -> Measurement:
        """Return what arrives at ``tick`` instead of the plant's measurement ``seen``. Call once per tick, in order."""
        s, taken = self.settings, self._taken(seen, tick)
        self._past.append(taken)
        lagging = self._after(s.lag_at_s, tick)
        late = s.late_ticks + int(s.lag_growth * lagging + 1e-9) + (s.lag_ticks if lagging else 0)
        arrived, newest = (self._past[max(0, len(self._past) - 1 - ticks)] for ticks in (late, s.late_ticks))
        if late > s.late_ticks and s.lag_joint is not None:
            arrived = _spliced(newest, arrived, s.lag_joint)
        elif late > s.late_ticks:
            arrived = self._forged(arrived, taken)
        arrived = self._replayed(self._stuck(arrived, taken, tick), taken, tick)
        if s.drop_share > 0.0 and self._last is not None and self._drops.uniform() < s.drop_share:
            arrived = self._last
        self._last = arrived
        return arrived

    def _taken(self, seen: Measurement, tick: int) -> Measurement:
        s, t = self.settings, tick * self._period
        q, v = seen.q + self._bias, seen.v
        if s.encoder_noise_rad > 0.0:
            q = q + self._noise.normal(scale=s.encoder_noise_rad, size=q.size)
        if s.jump_at_s is not None and t >= s.jump_at_s:
            q = q + s.jump_rad
        if 0 < self._after(s.nan_at_s, tick) <= s.nan_ticks:
            q = np.full_like(q, np.nan)
        if s.drift_rad_per_s != 0.0 and t > s.drift_at_s:
            q = q + (t - s.drift_at_s) * self._drift
            v = v + self._drift if s.drift_velocity == "included" else v
        return seen._replace(q=q, v=v)

    def _after(self, at_s: float | None, tick: int) -> int:
        """Return the number of ticks since ``at_s``, 1 at the first of them; 0 before."""
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
        after = self._after(self.settings.replay_at_s, tick)
        if after == 1:
            self._tape = list(self._past)[-self.settings.replay_ticks :]
        return self._forged(self._tape[(after - 1) % len(self._tape)], taken) if after else arrived


def _spliced(arrived: Measurement, other: Measurement, joint: int) -> Measurement:
    q, v = np.array(arrived.q), np.array(arrived.v)
    q[joint], v[joint] = other.q[joint], other.v[joint]
    return arrived._replace(q=q, v=v)
