"""The simulation of coverage: shares and widths that are known beforehand."""

import numpy as np
import pytest

from benchmarks import coverage
from moc_opt.scenario import Scenario
from moc_opt.study.solver_closed_loop import CHANGES

POOL = np.random.default_rng(0).lognormal(0.0, 0.3, (2, 240))


def test_a_change_that_all_trials_share_is_held_by_every_interval():
    treated, control = 1.2 * POOL[0], POOL[0]
    assert coverage.covered((treated, control, 15, 5)) == (100.0, pytest.approx(0.0, abs=1e-9))


def test_intervals_of_more_trials_are_shorter_and_hold_the_truth_about_as_often():
    (few, wide), (many, narrow) = (coverage.covered((*POOL, size, 60)) for size in (15, 60))
    assert 0.4 < narrow / wide < 0.6  # the root of 15/60 is a half; of few samples the interval is expanded
    assert few > 85.0
    assert many > 85.0
    # Against another truth than its own pool's, an interval misses.
    rng = np.random.default_rng(1)
    assert coverage.covered((POOL[0] * np.where(rng.random(240) < 0.01, 1e3, 1.0), POOL[1], 15, 30))[0] < 50.0


def test_one_trial_is_run_under_the_baseline_and_every_solver():
    trial = Scenario(duration_s=0.02, bound_samples=0)
    found = coverage.metrics_of((trial, {"exact": {}, "rnn": {"steps": 5}}))
    assert list(found) == ["dcac", "exact", "rnn"]
    assert set(found["rnn"]) == set(CHANGES)
