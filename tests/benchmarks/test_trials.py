"""The trials of every study are independent."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import coverage, faults, paper, plan, plant, robots, sweep
from moc_opt.scenario import Scenario, Setup
from moc_opt.study import solvers
from moc_opt.study.command import CONFIGS

STUDIES = {
    "solvers": solvers, "solvers-full": solvers, "plan": plan, "plan-limits": plan, "robots": robots, "plant": plant,
    "paper": paper, "faults": faults, "sweep": sweep, "margins": sweep, "accuracy": sweep,
}  # fmt: skip


def shipped(name: str) -> list[Scenario]:
    study = STUDIES[name]
    config = study.Config.load((Path(solvers.__file__).parent if study is solvers else CONFIGS) / f"{name}.toml")
    if study is sweep:
        return [config.scenario.change(seed=seed) for seed in config.chosen_seeds()]
    if study is plant:
        return [*config.cases(), *config.cases(plant.CALIBRATION_STREAM, config.calibration.trials)]
    return config.scenarios() if study is faults else config.cases()


@pytest.mark.parametrize("name", STUDIES)
def test_trials_share_no_seed_start_or_registration(name: str) -> None:
    found = shipped(name)
    assert len({trial.seed for trial in found}) == len(found) > 1
    # Only some of the trials, because finding a start is slow.
    some = [Setup(trial.change(best_courses=False)) for trial in found[:: -(-len(found) // 7)]]
    assert len({(setup.robot.data.name, *setup.q_start.round(9)) for setup in some}) == len(some)
    assert len({tuple(setup.plant.mismatch.registration_error) for setup in some}) == len(some)


def test_study_of_interval_coverage_shares_no_trial_with_the_solver_study() -> None:
    pool = {case.seed for case in coverage.Config().cases()}
    assert len(pool) == coverage.Config().trials
    assert not {trial.seed for name in ("solvers", "solvers-full") for trial in shipped(name)} & pool


POOL = np.random.default_rng(0).lognormal(0.0, 0.3, (2, 240))


def test_more_trials_give_shorter_intervals() -> None:
    (few, wide), (many, narrow) = (coverage.covered(*POOL, size, 60) for size in (15, 60))
    assert 0.4 < narrow / wide < 0.6  # about sqrt(15/60)
    assert min(few, many) > 85.0
    # A sample of 15 trials often lacks the rare large values.
    rng = np.random.default_rng(1)
    assert coverage.covered(POOL[0] * np.where(rng.random(240) < 0.01, 1e3, 1.0), POOL[1], 15, 30)[0] < 50.0


def test_coverage_study_has_a_row_for_every_metric(tiny: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = coverage.Config.cases
    monkeypatch.setattr(coverage.Config, "cases", lambda config: cases(config)[:3])
    monkeypatch.setattr(coverage, "SOLVERS", ("rnn-printed",))
    scenario = '[scenario]\nduration_s = 0.02\nbound_samples = 0\nstart = { pose = "home" }\n'
    found = tiny(coverage, f"trials = 120\ndraws = 3\n{scenario}").summary["coverage"]
    assert {row["trials"] for row in found.values()} == {3}
    assert len(found) == len(coverage.METRICS)
