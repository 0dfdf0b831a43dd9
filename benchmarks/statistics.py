"""Means and changes with bootstrap intervals: what a handful of trials can say, and how surely.

Resampling is scipy's: bias-corrected and accelerated (Efron 1987), over trials, and over pairs where two controllers
ran the same trials. Ticks of one trial are not independent, so they are never resampled.

Two controllers are compared by the ratio of their means (`relative_change`), never by a mean of the trials' ratios, in
which a trial with a small denominator counts for more.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from moc_opt.errors import MocOptError

Array = NDArray[np.float64]

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
        """{name, name_low, name_high}, for a summary."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


def spread(entries: Mapping[str, Any], name: str, digits: int = 3) -> str | None:
    """A figure of a summary with its interval, as text; None where there is none."""
    value, low, high = (entries.get(key) for key in (name, f"{name}_low", f"{name}_high"))
    if value is None:
        return None
    if low is None or high is None or low != low:
        return f"{value:.{digits}g}"
    return f"{value:.{digits}g} [{low:.{digits}g}, {high:.{digits}g}]"


def mean(samples: ArrayLike, *, seed: int = 0, confidence: float = CONFIDENCE) -> Interval:
    """Mean of one number a trial, (k,), with its interval.

    Raises:
        StatisticsError: no sample, or one that is not finite.
    """
    return _interval([_checked("samples", samples)], _mean, seed, confidence)


def relative_change(
    treated: ArrayLike, control: ArrayLike, *, seed: int = 0, confidence: float = CONFIDENCE
) -> Interval:
    """100 (mean(treated)/mean(control) - 1) [percent], for (k,) numbers of the same k trials: resampled in pairs.

    Raises:
        StatisticsError: no pair, different lengths, a number that is not finite, or controls with mean 0.
    """
    a, b = _checked("treated", treated), _checked("control", control)
    if len(a) != len(b):
        raise StatisticsError(f"treated has {len(a)} samples, control {len(b)}: give the same trials")
    if b.mean() == 0.0:
        raise StatisticsError("control has mean 0: a change relative to it has no value")
    return _interval([a, b], _change, seed, confidence)


def difference_of_changes(
    treated: ArrayLike,
    control: ArrayLike,
    treated_before: ArrayLike,
    control_before: ArrayLike,
    *,
    seed: int = 0,
    confidence: float = CONFIDENCE,
) -> Interval:
    """``relative_change`` of one pair of controllers less that of another [percentage points], on the same k trials.

    Raises:
        StatisticsError: no trial, different lengths, a number that is not finite, or controls with mean 0.
    """
    names = ("treated", "control", "treated_before", "control_before")
    samples = [
        _checked(name, given)
        for name, given in zip(names, (treated, control, treated_before, control_before), strict=True)
    ]
    if len({len(sample) for sample in samples}) != 1:
        raise StatisticsError(f"{', '.join(names)}: {[len(s) for s in samples]} samples: give the same trials")
    if samples[1].mean() == 0.0 or samples[3].mean() == 0.0:
        raise StatisticsError("control has mean 0: a change relative to it has no value")
    return _interval(samples, _difference, seed, confidence)


def _difference(a: Array, b: Array, c: Array, d: Array, axis: int = -1) -> Array:
    found: Array = _change(a, b, axis=axis) - _change(c, d, axis=axis)
    return found


def _mean(samples: Array, axis: int = -1) -> Array:
    found: Array = np.mean(samples, axis=axis)
    return found


def _change(treated: Array, control: Array, axis: int = -1) -> Array:
    found: Array = 100.0 * (np.mean(treated, axis=axis) / np.mean(control, axis=axis) - 1.0)
    return found


def _checked(name: str, samples: ArrayLike) -> Array:
    array = np.asarray(samples, dtype=np.float64)
    if array.ndim != 1 or array.size == 0 or not np.isfinite(array).all():
        raise StatisticsError(
            f"{name} = {array.tolist()!r:.200}: give one finite number a trial, one trial or more"
        )
    return array


def _interval(
    samples: Sequence[Array], statistic: Callable[..., Any], seed: int, confidence: float
) -> Interval:
    value, count = float(statistic(*samples)), len(samples[0])
    if count < 2:
        return Interval(value, float("nan"), float("nan"), count)
    arguments: dict[str, Any] = {
        "paired": True, "vectorized": True, "n_resamples": RESAMPLES, "confidence_level": confidence,
    }  # fmt: skip
    low = high = float("nan")
    for method in ("BCa", "percentile"):
        # BCa has no value where all resamples agree or the jackknife does; the percentiles always have.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", stats.DegenerateDataWarning)
            warnings.simplefilter("ignore", RuntimeWarning)
            found = stats.bootstrap(
                tuple(samples), statistic, method=method, rng=np.random.default_rng(seed), **arguments
            ).confidence_interval
        low, high = float(found.low), float(found.high)
        if np.isfinite(low) and np.isfinite(high):
            break
    return Interval(value, low, high, count)
