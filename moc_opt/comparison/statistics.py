"""Means and changes over a few trials, with bootstrap intervals.

Resampling is scipy's: bias-corrected and accelerated (Efron 1987), over trials, and over pairs where two controllers
ran the same trials. Ticks of one trial are not independent, so they are never resampled.

With few trials the intervals are too short. Of 1000 sets of normal samples the interval for 95 % held the mean in 71 %
with three samples, 82 % with five, 89 % with eight, 93 % with fifteen and 94 % with 45; of log-normal ones (sigma 0.5)
in 70, 81, 87, 91 and 93 %.

Two controllers are compared by the ratio of their means (`relative_change`), never by a mean of the trials' ratios, in
which a trial with a small denominator counts for more.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from moc_opt.errors import MocOptError
from moc_opt.numerics.arrays import Array

_FILTERS = threading.Lock()
"""Held while warnings are off: they are the process's own, and several threads ask for intervals."""
RESAMPLES = 4000
CONFIDENCE = 0.95


class StatisticsError(MocOptError, ValueError):
    """Samples that no statistic can be made of."""


class Interval(NamedTuple):
    """A statistic and its confidence interval; `low` and `high` are NaN where a single sample gives none."""

    value: float
    low: float
    high: float
    samples: int

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"

    def entries(self, name: str) -> dict[str, float]:
        """Return {name, name_low, name_high}, for a summary."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


def spread(entries: Mapping[str, Any], name: str, digits: int = 3) -> str | None:
    """Return a figure of a summary with its interval, as text; None where there is none."""
    value, low, high = (entries.get(key) for key in (name, f"{name}_low", f"{name}_high"))
    if value is None:
        return None
    if low is None or high is None or low != low:
        return f"{value:.{digits}g}"
    return f"{value:.{digits}g} [{low:.{digits}g}, {high:.{digits}g}]"


def share(found: int, trials: int, *, confidence: float = CONFIDENCE) -> Interval:
    """Return found/trials with its exact binomial interval (Clopper and Pearson, Biometrika 26, 1934).

    The interval holds where the trials are independent; events that come in bunches have a wider one.

    Raises:
        StatisticsError: not 0 <= found <= trials, or no trials.

    Example:
        >>> str(share(0, 300_000))
        '0 [0, 1.23e-05]'
    """
    if not 0 <= found <= trials or trials < 1:
        raise StatisticsError(f"found = {found}, trials = {trials}: give at least one trial, and 0 to so many found")
    low, high = stats.binomtest(found, trials).proportion_ci(confidence)
    return Interval(found / trials, float(low), float(high), trials)


def mean(samples: ArrayLike, *, seed: int = 0, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of one number a trial, (k,), with its interval.

    Raises:
        StatisticsError: no sample, or one that is not finite.
    """
    return _interval(_mean, seed, confidence, samples=samples)


def relative_change(
    treated: ArrayLike, control: ArrayLike, *, seed: int = 0, confidence: float = CONFIDENCE
) -> Interval:
    """Compute 100 (mean(treated)/mean(control) - 1) [percent] of (k,) numbers of the same k trials, resampled in pairs.

    Raises:
        StatisticsError: no pair, different lengths, a number that is not finite, or controls with mean 0.
    """
    return _interval(_change, seed, confidence, treated=treated, control=control)


def difference_of_changes(
    treated: ArrayLike, control: ArrayLike, treated_before: ArrayLike, control_before: ArrayLike, *, seed: int = 0,
    confidence: float = CONFIDENCE,
) -> Interval:  # fmt: skip
    """Subtract the `relative_change` of one pair from that of another [percentage points], on the same k trials.

    Raises:
        StatisticsError: no trial, different lengths, a number that is not finite, or controls with mean 0.
    """
    before = {"treated_before": treated_before, "control_before": control_before}
    return _interval(_difference, seed, confidence, treated=treated, control=control, **before)


def _mean(samples: Array, axis: int = -1) -> Array:
    return np.asarray(np.mean(samples, axis=axis))


def _change(treated: Array, control: Array, axis: int = -1) -> Array:
    return 100.0 * (_mean(treated, axis) / _mean(control, axis) - 1.0)


def _difference(a: Array, b: Array, c: Array, d: Array, axis: int = -1) -> Array:
    return _change(a, b, axis) - _change(c, d, axis)


def _checked(given: Mapping[str, ArrayLike]) -> list[Array]:
    """Return the samples by name, (k,) each.

    Raises:
        StatisticsError: they make no statistic.
    """
    found = {name: np.asarray(samples, dtype=np.float64) for name, samples in given.items()}
    for name, array in found.items():
        if array.ndim != 1 or array.size == 0 or not np.isfinite(array).all():
            raise StatisticsError(
                f"{name} = {array.tolist()!r:.200}: give one finite number a trial, one trial or more"
            )
    (first, count), *others = [(name, len(array)) for name, array in found.items()]
    if any(length != count for _, length in others):
        lengths = ", ".join(f"{name} {length}" for name, length in others)
        raise StatisticsError(f"{first} has {count} samples, {lengths}: give the same trials")
    if any(name.startswith("control") and array.mean() == 0.0 for name, array in found.items()):
        raise StatisticsError("control has mean 0: a change relative to it has no value")
    return list(found.values())


def _interval(statistic: Callable[..., Any], seed: int, confidence: float, **given: ArrayLike) -> Interval:
    samples = _checked(given)
    value, count, low, high = float(statistic(*samples)), len(samples[0]), float("nan"), float("nan")
    if count < 2:
        return Interval(value, low, high, count)
    for method in ("BCa", "percentile"):
        # BCa has no value where all resamples agree or the jackknife does; the percentiles always have.
        with _FILTERS, warnings.catch_warnings():
            warnings.simplefilter("ignore", stats.DegenerateDataWarning)
            warnings.simplefilter("ignore", RuntimeWarning)
            found = stats.bootstrap(
                tuple(samples), statistic, method=method, rng=np.random.default_rng(seed), paired=True,
                vectorized=True, n_resamples=RESAMPLES, confidence_level=confidence,
            ).confidence_interval  # fmt: skip
        low, high = float(found.low), float(found.high)
        if np.isfinite(low) and np.isfinite(high):
            break
    return Interval(value, low, high, count)
