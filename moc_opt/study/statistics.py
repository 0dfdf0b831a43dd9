"""Means and changes over independent trials, with bootstrap confidence intervals.

Intervals are scipy's BCa bootstrap (Efron 1987), expanded for few samples (Hesterberg 2015; see docs/method.md), and
widened to contain Student's t interval with the jackknife's standard error.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError

RESAMPLES = 4000
CONFIDENCE = 0.95
NOMINAL = 0.7
"""In simulations, bootstrap intervals miss the true value more often than the rate 1 - `CONFIDENCE` allows. So
the intervals are computed for a smaller rate of misses: `NOMINAL` times (1 - `CONFIDENCE`)."""
ROUNDING = 1e-9  # smaller changes count as zero [percent]
LEAST_TRIALS = 8  # with fewer trials, a change is called neither a gain nor a loss


def too_few(trials: int) -> str | None:
    """Return a message if there are too few trials, else None."""
    return f"too few trials to decide ({trials} of at least {LEAST_TRIALS})" if trials < LEAST_TRIALS else None


class StatisticsError(MocOptError, ValueError):
    """A statistic has no value for these samples."""


class Interval(NamedTuple):
    """A statistic and its confidence interval (NaN for a single sample)."""

    value: float
    low: float
    high: float
    samples: int

    def __str__(self) -> str:
        return f"{self:.4g}"

    def __format__(self, form: str) -> str:
        return f"{self.value:{form}} [{self.low:{form}}, {self.high:{form}}]"

    def entries(self, name: str) -> dict[str, float]:
        """Return entries for a summary."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


class Change(NamedTuple):
    """A change computed in two ways [percent]."""

    ratio: Interval  #: 100 (mean of the treated / mean of the control - 1)
    ratios: Interval  #: mean over the trials of 100 (treated / control - 1)

    def side(self, bound: float = 0.0) -> int:
        """Return 1 if both intervals lie above the bound [percent], -1 if both lie below it, else 0.

        With fewer than `LEAST_TRIALS` trials, return 0.
        """
        both = {int(one.low > bound + ROUNDING) - int(one.high < bound - ROUNDING) for one in self}
        return both.pop() if len(both) == 1 and self.ratio.samples >= LEAST_TRIALS else 0

    @property
    def undecided(self) -> bool:
        """Whether the two values differ in sign, or only one interval contains 0."""
        sides = [(one.low > ROUNDING, one.high < -ROUNDING) for one in self]
        values = self.ratio.value, self.ratios.value
        opposed = min(values) < -ROUNDING and max(values) > ROUNDING
        return opposed or sides[0] != sides[1]

    def __str__(self) -> str:
        return f"{self.ratio:.3g}" + (f" (undecided: mean of ratios {self.ratios:.3g})" if self.undecided else "")

    def entries(self, name: str) -> dict[str, float]:
        """Return entries for a summary."""
        return {
            **self.ratio.entries(name), **self.ratios.entries(f"{name}_of_ratios"),
            f"{name}_undecided": float(self.undecided),
        }  # fmt: skip


def spread(entries: Mapping[str, Any], name: str, digits: int = 3, sign: str = "", unit: str = "") -> str | None:
    """Return a summary's number and its interval as text, or None if the number is absent."""
    value, low, high = (entries.get(key) for key in (name, f"{name}_low", f"{name}_high"))
    if value is None:
        return None

    def written(one: float, sign: str = "") -> str:
        return f"{one:{sign}.0f}" if abs(one) >= 10.0**digits else f"{one:{sign}.{digits}g}"

    text = written(value, sign)
    if low is not None and high is not None and low == low:
        text += f" [{written(low)}, {written(high)}]"
    text += unit
    if entries.get(f"{name}_undecided"):
        text += f" (undecided: mean of ratios {spread(entries, f'{name}_of_ratios', digits, sign, unit)})"
    return text


def share(found: int, trials: int) -> Interval:
    """Return found/trials with the exact binomial interval (Clopper and Pearson 1934)."""
    if not 0 <= found <= trials or trials < 1:
        raise StatisticsError(f"found = {found}, trials = {trials}: give at least one trial, and 0 <= found <= trials")
    from scipy import stats  # slow to import

    low, high = stats.binomtest(found, trials).proportion_ci(CONFIDENCE)
    return Interval(found / trials, float(low), float(high), trials)


def mean(samples: ArrayLike) -> Interval:
    """Return the mean. Raise a StatisticsError if ``samples`` (k,) is empty or not finite."""
    return _interval(np.mean, samples=samples)


def relative_change(treated: ArrayLike, control: ArrayLike) -> Interval:
    """Compute 100 (mean(treated)/mean(control) - 1) [percent] from arrays (k,) of the same trials.

    Raises:
        StatisticsError: empty arrays, different lengths, a number that is not finite, or ``control`` has mean 0.
    """
    return _interval(_change, treated=treated, control=control)


def relative_changes(treated: ArrayLike, control: ArrayLike) -> Change:
    """Return the `Change` from arrays (k,) of the same trials."""
    ratio = relative_change(treated, control)
    with np.errstate(divide="ignore", invalid="ignore"):
        each = 100.0 * (np.asarray(treated, float) / np.asarray(control, float) - 1.0)
    return Change(ratio, mean(each))


def difference_of_changes(
    treated: ArrayLike, control: ArrayLike, treated_before: ArrayLike, control_before: ArrayLike
) -> Interval:
    """Return the `relative_change` minus that of the "before" samples [percentage points]."""
    before = {"treated_before": treated_before, "control_before": control_before}
    return _interval(_difference, treated=treated, control=control, **before)


def _change(treated: Array, control: Array, axis: int = -1) -> Array:
    return np.asarray(100.0 * (np.mean(treated, axis=axis) / np.mean(control, axis=axis) - 1.0))


def _difference(a: Array, b: Array, c: Array, d: Array, axis: int = -1) -> Array:
    return _change(a, b, axis) - _change(c, d, axis)


def _checked(given: Mapping[str, ArrayLike]) -> list[Array]:
    found = {name: np.asarray(samples, dtype=np.float64) for name, samples in given.items()}
    for name, array in found.items():
        if array.ndim != 1 or array.size == 0 or not np.isfinite(array).all():
            raise StatisticsError(f"{name} = {array.tolist()!r:.200}: give one finite number for each trial")
        if name.startswith("control") and array.mean() == 0.0:
            raise StatisticsError(f"{name} has mean 0: a change relative to it has no value")
    if len({len(array) for array in found.values()}) > 1:
        raise StatisticsError(f"{' and '.join(found)} have different lengths: give the same trials for each")
    return list(found.values())


def _interval(statistic: Callable[..., Any], **given: ArrayLike) -> Interval:
    samples = _checked(given)
    value, count, low, high = float(statistic(*samples)), len(samples[0]), float("nan"), float("nan")
    if count < 2:
        return Interval(value, low, high, count)
    from scipy import stats  # slow to import

    quantile = float(stats.t.ppf(1.0 - 0.5 * NOMINAL * (1.0 - CONFIDENCE), count - 1))
    expanded = float(2.0 * stats.norm.cdf(np.sqrt(count / (count - 1)) * quantile) - 1.0)
    half = quantile * _standard_error(statistic, samples)
    for method in ("BCa", "percentile"):
        # If all resamples agree, BCa has no value.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # degenerate samples
            found = stats.bootstrap(
                tuple(samples), statistic, method=method, rng=np.random.default_rng(0), paired=True,
                vectorized=True, n_resamples=RESAMPLES, confidence_level=min(expanded, 0.9999),
            ).confidence_interval  # fmt: skip
        low, high = float(found.low), float(found.high)
        if np.isfinite(low) and np.isfinite(high):
            break
    return Interval(value, min(low, value - half), max(high, value + half), count)


def _standard_error(statistic: Callable[..., Any], samples: Sequence[Array]) -> float:
    """Return the jackknife's standard error, or 0 if it is not finite."""
    count = len(samples[0])
    left = [np.array([np.delete(sample, k) for k in range(count)]) for sample in samples]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.asarray(statistic(*left, axis=-1))
    return float(np.sqrt(count - 1) * found.std()) if np.isfinite(found).all() else 0.0
