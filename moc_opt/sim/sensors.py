"""The measurement, and the models of noise and encoders."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moc_opt import core
from moc_opt.arrays import Array, read_only
from moc_opt.sim.settings import PlantSettings


class Measurement(NamedTuple):
    """The readings that the controller gets."""

    q: Array  #: (n,) joint positions [rad].
    v: Array  #: (n,) joint velocities [rad/s].
    force: Array  #: (6,) force [N] and torque [Nm] of the tool on its mount, in tool axes; one plant step old.
    stamp: int = 0  #: Number of the control period in which the reading was taken.


_NOISE_ROWS = 256


class Noise:
    """Gaussian noise of given standard deviations (m,)."""

    def __init__(self, rng: np.random.Generator, deviation: Array) -> None:
        self._rng, self._deviation, self._quiet = rng, deviation, not deviation.any()
        self._block, self._next = np.zeros((_NOISE_ROWS, deviation.size)), _NOISE_ROWS
        self._rows = list(self._block)  # indexing a list is faster than indexing an array

    def take(self) -> Array:
        """Return the next row (m,), valid until the next call."""
        if self._quiet:
            return self._rows[0]
        if self._next == _NOISE_ROWS:
            self._rng.standard_normal(out=self._block)
            self._block *= self._deviation
            self._next = 0
        self._next += 1
        return self._rows[self._next - 1]


class Encoders:
    """Joint positions with ``bias`` (n,) [rad], noise and a finite step, and velocities from filtered differences.

    velocity += (1 - exp(-2 pi cutoff period)) (difference quotient - velocity), once a control period.
    If noise, step and cutoff are all 0, the velocity is exact.
    """

    def __init__(self, settings: PlantSettings, bias: Array, rng: np.random.Generator) -> None:
        noise, step, cutoff = settings.encoder_noise_rad, settings.encoder_resolution_rad, settings.velocity_cutoff_Hz
        gain = -math.expm1(-2.0 * math.pi * cutoff * settings.period_s) if cutoff > 0.0 else 1.0
        # rows: bias [rad], last position [rad], velocity estimate [rad/s]
        self._noise, self._memory = Noise(rng, np.full(bias.size, noise)), np.zeros((3, bias.size))
        self._memory[0] = bias
        self._conversion = step, settings.period_s, gain, noise == step == cutoff == 0.0

    def start(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the first reading at (q, v), (n,) each."""
        self._memory[2] = v
        resolution, period, _, exact = self._conversion
        return self._sample(q, v, (resolution, period, 0.0, exact))

    def read(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the next position [rad] and velocity [rad/s], (n,) each."""
        return self._sample(q, v, self._conversion)

    def _sample(self, q: Array, v: Array, conversion: tuple[float, float, float, bool]) -> tuple[Array, Array]:
        reading = np.empty((2, q.size))
        core.read_encoders(q, v, self._noise.take(), self._memory, *conversion, reading)
        read_only(reading)
        return reading[0], reading[1]


_CHANCE = 1e-10  #: Accepted probability p^k in `longest_repetition`.
_MOST_TICKS = 500  #: Largest result of `longest_repetition`.


def longest_repetition(noise_rad: float, resolution_rad: float) -> int | None:
    """Return how often in a row an encoder at rest may repeat its reading.

    With step s and noise sigma, a reading repeats with a probability of at most p = erf(s / (sqrt(8) sigma)). The
    result is the first k >= 10 with p^k below `_CHANCE`. It is None without noise, or if k exceeds `_MOST_TICKS`.
    """
    if noise_rad == 0.0:
        return None
    same = math.erf(resolution_rad / (math.sqrt(8.0) * noise_rad))
    if same >= _CHANCE ** (1.0 / _MOST_TICKS):
        return None
    return max(10, math.ceil(math.log(_CHANCE) / math.log(max(same, _CHANCE))))


_DEAD = 600.0  #: A decaying filter output needs more than this many time constants to underflow.


def repeats_no_reading(noise_rad: float, resolution_rad: float, cutoff_Hz: float, period_s: float) -> bool:
    """Return whether an encoder never repeats its position and its velocity together.

    While the position repeats, the filtered velocity decays and so does not repeat, until it underflows to 0. The
    position must change before that.
    """
    longest = longest_repetition(noise_rad, resolution_rad)
    return longest is not None and 0.0 < 2.0 * math.pi * cutoff_Hz * period_s * longest < _DEAD
