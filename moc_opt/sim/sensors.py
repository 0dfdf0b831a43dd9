"""The controller's sensors: joint encoders, and the six-axis force/torque sensor at the tool mount."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moc_opt.numerics.arrays import Array, read_only
from moc_opt.numerics.cache import njit
from moc_opt.sim.settings import PlantSettings


class Measurement(NamedTuple):
    """The readings that the controller gets; read-only arrays."""

    q: Array
    """(n,) joint positions [rad]."""
    v: Array
    """(n,) joint velocities [rad/s]."""
    force: Array
    """(6,) force [N] and torque [Nm] of the tool on its mount, axes of link "tool", one plant step old."""
    stamp: int = 0
    """Number of the control period in which it was taken, counted by the arm, which gives the reading's age."""


_NOISE_ROWS = 256


class _Noise:
    """Gaussian noise, drawn in blocks: the same numbers as row by row, at a fraction of the calls.

    Attributes:
        row: (m,) of the next reading, valid until it is taken.
    """

    def __init__(self, rng: np.random.Generator, deviation: Array) -> None:
        """Build it with the standard deviation of each entry (m,)."""
        self._rng, self._deviation = rng, deviation
        self._block, self._next = np.zeros((_NOISE_ROWS, deviation.size)), _NOISE_ROWS
        self._rows = list(self._block)  # views: taking one from a list costs a quarter of making it
        self._quiet = not deviation.any()
        self.row = self._rows[0]
        self.take()

    @property
    def ahead(self) -> Array:
        """(k, m) of the next readings, ``row`` first: as many as are drawn."""
        return self._block if self._quiet else self._block[self._next - 1 :]

    def take(self, rows: int = 1) -> None:
        """Move on by so many rows, of those ``ahead`` at most."""
        if self._quiet or rows == 0:
            return
        self._next += rows - 1
        if self._next == _NOISE_ROWS:
            self._rng.standard_normal(out=self._block)
            self._block *= self._deviation
            self._next = 0
        self.row = self._rows[self._next]
        self._next += 1


@njit(cache=True, nogil=True)
def sample(q: Array, v: Array, noise: Array, memory: Array, conversion: Array, reading: Array) -> None:
    """Read encoders: positions [rad], then velocities [rad/s], into reading (2 n,).

    Args:
        q, v: (n,) true ones.
        noise: (n,) [rad].
        memory: (3, n) rows: bias [rad]; written: last position [rad], estimate of the velocity [rad/s].
        conversion: (4,) resolution [rad], period [s], share of the difference quotient that the estimate takes up, and
            whether both values are exact but for the bias.
    """
    n = q.size
    resolution, period, gain = conversion[0], conversion[1], conversion[2]
    for i in range(n):
        reading[i], reading[n + i] = q[i] + memory[0, i], v[i]
        if conversion[3] == 0.0:
            position = reading[i] + noise[i]
            if resolution > 0.0:
                position = resolution * np.rint(position / resolution)
            memory[2, i] += gain * ((position - memory[1, i]) / period - memory[2, i])
            reading[i], reading[n + i], memory[1, i] = position, memory[2, i], position


class Encoders:
    """Joint positions with bias, noise and a finite step; velocities from their low-passed difference quotient.

    velocity += (1 - exp(-2 pi cutoff period)) (difference quotient - velocity), once a control period.
    Without noise, step and cutoff both values are exact but for the bias; without a cutoff alone, the velocity is
    the bare quotient.

    Attributes:
        noise: makes their noise, a row a reading.
        memory, conversion: as ``sample`` takes them.
    """

    def __init__(
        self, n: int, period_s: float, rng: np.random.Generator, *, noise_rad: float = 0.0,
        resolution_rad: float = 0.0, cutoff_Hz: float = 0.0, bias: Array | None = None,
    ) -> None:  # fmt: skip
        """Build n encoders that are read every `period_s`; noise is a standard deviation, bias (n,) constant [rad]."""
        exact = noise_rad == resolution_rad == cutoff_Hz == 0.0
        gain = -math.expm1(-2.0 * math.pi * cutoff_Hz * period_s) if cutoff_Hz > 0.0 else 1.0
        self.noise = _Noise(rng, np.full(n, noise_rad))
        self.memory, self.conversion = np.zeros((3, n)), np.array([resolution_rad, period_s, gain, exact])
        self.memory[0] = 0.0 if bias is None else bias

    @classmethod
    def of(cls, settings: PlantSettings, bias: Array, rng: np.random.Generator) -> Encoders:
        """Return the encoders that the plant's settings describe, with the bias (n,) that was drawn for them."""
        return cls(
            bias.size, settings.period_s, rng, noise_rad=settings.encoder_noise_rad,
            resolution_rad=settings.encoder_resolution_rad, cutoff_Hz=settings.velocity_cutoff_Hz, bias=bias,
        )  # fmt: skip

    def start(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Read at (q, v), each (n,), for the first time: the velocity estimate begins at v."""
        self.memory[2] = v
        return self._sample(q, v, self.conversion * [1.0, 1.0, 0.0, 1.0])

    def read(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the reading one period after the last: position [rad] and velocity [rad/s], (n,) read-only."""
        return self._sample(q, v, self.conversion)

    def _sample(self, q: Array, v: Array, conversion: Array) -> tuple[Array, Array]:
        reading = np.empty(2 * q.size)
        sample(q, v, self.noise.row, self.memory, conversion, reading)
        self.noise.take()
        read_only(reading)
        return reading[: q.size], reading[q.size :]


class WrenchSensor:
    """Noise on the wrench that the tool exerts on the mount."""

    def __init__(self, rng: np.random.Generator, *, force_noise_N: float = 0.0, torque_noise_Nm: float = 0.0) -> None:
        """Build it with the standard deviations of one axis."""
        self.noise = _Noise(rng, np.repeat([force_noise_N, torque_noise_Nm], 3))

    @classmethod
    def of(cls, settings: PlantSettings, rng: np.random.Generator) -> WrenchSensor:
        """Return the sensor that the plant's settings describe."""
        return cls(rng, force_noise_N=settings.force_noise_N, torque_noise_Nm=settings.torque_noise_Nm)

    def read(self, held: Array) -> Array:
        """Return force [N] and torque [Nm] as measured, (6,) read-only, where the mount truly holds with ``held``.

        The sensor shows the reaction to that: its negative.
        """
        reading = self.noise.row - held
        self.noise.take()
        return read_only(reading)


_CHANCE = 1e-10
"""Of a longer repetition, at each reading, where the joint stands in the middle of a step."""
_MOST_TICKS = 500


def longest_repetition(noise_rad: float, resolution_rad: float) -> int | None:
    """Return for how many readings in a row noise lets an encoder at rest repeat itself to the last bit.

    In the middle of a step of width s a reading with noise sigma is the same with probability p = erf(s / (sqrt(8)
    sigma)), anywhere else with less; p^k falls below one in 10^10. None where there is no noise, or so little that
    more than 500 are needed.
    """
    if noise_rad == 0.0:
        return None
    same = math.erf(resolution_rad / (math.sqrt(8.0) * noise_rad))
    if same >= _CHANCE ** (1.0 / _MOST_TICKS):
        return None
    return max(10, math.ceil(math.log(_CHANCE) / math.log(max(same, _CHANCE))))


_DEAD = 600.0
"""Time constants of a filter after which its output is so small that it may stay the same."""


def repeats_no_reading(noise_rad: float, resolution_rad: float, cutoff_Hz: float, period_s: float) -> bool:
    """Decide whether an encoder never repeats position and velocity together, to the last bit.

    While the position repeats itself the filtered velocity dies out, and each value differs from the last one; noise
    ends that long before it is too small a number to change.
    """
    longest = longest_repetition(noise_rad, resolution_rad)
    return longest is not None and 0.0 < 2.0 * math.pi * cutoff_Hz * period_s * longest < _DEAD
