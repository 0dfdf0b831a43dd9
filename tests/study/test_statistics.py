"""Bootstrap intervals."""

import numpy as np
import pytest

from moc_opt.study import statistics
from moc_opt.study.statistics import StatisticsError, mean, relative_change, relative_changes, share


def test_difference_of_changes_resamples_whole_trials():
    """If each change is the same in all trials, the interval of their difference has no width."""
    control = np.array([0.1, 1.0, 10.0, 3.0, 0.5])
    found = statistics.difference_of_changes(1.2 * control, control, 0.7 * control, 2.0 * control)
    assert (found.value, found.low, found.high) == pytest.approx((85.0, 85.0, 85.0))
    rng = np.random.default_rng(0)
    a, b, c, d = rng.uniform(1.0, 2.0, (4, 12))
    noisy = statistics.difference_of_changes(a, b, c, d)
    assert noisy.value == pytest.approx(relative_change(a, b).value - relative_change(c, d).value)
    assert noisy.low < noisy.value < noisy.high


@pytest.mark.parametrize(("count", "skewed", "least"), [(15, False, 0.86), (15, True, 0.90), (8, True, 0.90)])
def test_interval_of_the_mean_covers_the_truth(count, skewed, least):
    """The nominal coverage is 95 %."""
    rng = np.random.default_rng(4 if skewed else 0)
    draw, truth = (rng.lognormal, np.exp(0.125)) if skewed else (rng.normal, 0.0)
    found = [mean(draw(0.0, 0.5, count)) for _ in range(200)]
    assert least <= np.mean([one.low <= truth <= one.high for one in found]) <= 0.99


def test_change_is_undecided_if_change_of_means_and_mean_change_differ_in_sign():
    control = np.array([0.1, 3.0, 3.1, 3.2] * 4)
    change = relative_changes([0.4, 2.0, 2.1, 2.2] * 4, control)
    assert change.ratio.high < 0.0 < change.ratios.value
    assert change.undecided
    assert change.side() == 0
    clear = relative_changes(1.2 * control, control)
    assert (clear.undecided, clear.side(), clear.side(25.0)) == (False, 1, -1)
    assert relative_changes(1.2 * control[:7], control[:7]).side() == 0  # fewer than LEAST_TRIALS


def test_interval_of_a_share_covers_the_truth():
    rng = np.random.default_rng(0)
    drawn, times = np.unique(rng.binomial(2000, 2e-3, 20_000), return_counts=True)
    holds = [(one := share(int(k), 2000)).low <= 2e-3 <= one.high for k in drawn]
    covered = times @ holds / times.sum()
    assert 0.95 <= covered < 0.995


@pytest.mark.parametrize(("call", "given", "said"), [
    (mean, [[]], "samples"), (mean, [[1.0, np.nan]], "samples"), (mean, [[[1.0, 2.0]]], "samples"),
    (relative_change, [[1.0, 2.0], [1.0, 2.0, 3.0]], "give the same trials"),
    (relative_change, [[1.0, 2.0], [-1.0, 1.0]], "mean 0"), (share, (0, 0), "give at least one trial"),
    (share, (-1, 5), "give at least one trial"), (share, (6, 5), "give at least one trial"),
])  # fmt: skip
def test_unusable_samples_are_refused(call, given, said):
    with pytest.raises(StatisticsError, match=said):
        call(*given)
