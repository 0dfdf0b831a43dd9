"""The simulation of coverage: shares and widths that are known beforehand."""

import numpy as np

from benchmarks import coverage
from moc_opt.study.command import CONFIGS

POOL = np.random.default_rng(0).lognormal(0.0, 0.3, (2, 240))


def test_intervals_of_more_trials_are_shorter_and_hold_the_truth_about_as_often():
    (few, wide), (many, narrow) = (coverage.covered(*POOL, size, 60) for size in (15, 60))
    assert 0.4 < narrow / wide < 0.6  # the root of 15/60 is a half; of few samples the interval is expanded
    assert min(few, many) > 85.0
    # Against another truth than its own pool's, an interval misses.
    rng = np.random.default_rng(1)
    assert coverage.covered(POOL[0] * np.where(rng.random(240) < 0.01, 1e3, 1.0), POOL[1], 15, 30)[0] < 50.0


def test_a_tiny_pool(tiny, monkeypatch):
    assert coverage.Config.load(CONFIGS / "coverage.toml") == coverage.Config()
    cases = coverage.Config.cases
    monkeypatch.setattr(coverage.Config, "cases", lambda config: cases(config)[:3])
    monkeypatch.setattr(coverage, "SOLVERS", ("rnn-printed",))
    scenario = '[scenario]\nduration_s = 0.02\nbound_samples = 0\nstart = { pose = "home" }\n'
    found = tiny(coverage, f"trials = 120\ndraws = 3\n{scenario}", pictures=0).summary["coverage"]
    assert {row["trials"] for row in found.values()} == {3}
    assert len(found) == len(coverage.METRICS)
