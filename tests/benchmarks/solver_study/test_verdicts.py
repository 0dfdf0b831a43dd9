"""Verdicts follow their stated rules: who lies, hangs, shakes or costs is avoided; who is right is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.solver_study.compare import COSTS
from benchmarks.solver_study.first_screen import sentences
from benchmarks.solver_study.verdicts import AVOID, GAPS, NEAR, OTHER, SOUND, TAKE, assess
from moc_opt.figures.notation import Doubtful

LOOP = {
    "mu_mean": 0.3, "tip_error_model_mean_mm": 0.2, "rcm_error_model_mean_mm": 0.4, "torque_rate_rms_Nm_per_s": 600.0,
    "tip_error_registered_mean_mm": 0.3, "rcm_error_registered_mean_mm": 0.5, "runs": 15, "mu_fraction_of_bound": 0.9,
}  # fmt: skip
NOISE = np.random.default_rng(3).lognormal(0.0, 0.5, 60)


def by_trial(row: dict[str, Any], trials: int = 15, unlike: float = 0.0) -> dict[str, dict[str, float]]:
    """The values of trials that differ much, and are the same multiple of the reference's up to ``unlike``."""
    own = np.random.default_rng(5).lognormal(0.0, unlike, trials) if unlike else np.ones(trials)
    values = NOISE[:trials] / NOISE[:trials].mean() * own
    return {
        metric: {f"circle/{k}": row[metric] * values[k] for k in range(trials)} for metric in COSTS if metric in row
    }  # fmt: skip


def sets(right: int = 1000, **more: Any) -> dict[str, Any]:
    found = {
        "solves": 1000, "right": right, "claimed_solved": right, "silently_wrong": 0, "hung": 0, "crashed": 0,
        "verified_solved": right, "optima_asked": 1000, "infeasible_asked": 0, "refused_inconsistent": 0,
    }  # fmt: skip
    return {**found, "solve_p50_us_worst_set": 5.0, "solve_p99_us_worst_set": 9.0, "relative_max": 1e-9, **more}


def verdicts(**solvers: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, Any]:
    """Solver -> its row, beside one that is sound and fastest."""
    every = {"best": (sets(solve_p99_us_worst_set=1.0), LOOP), **solvers}
    summary = {
        "testsets": {f"{name}@recommended": certified for name, (certified, _) in every.items()},
        "closed_loop": {"dcac": LOOP, **{name: closed for name, (_, closed) in every.items() if closed}},
        "closed_loop_trials": {name: by_trial(closed) for name, (_, closed) in every.items()},
    }
    return {row["solver"]: row for row in assess(summary)}


@pytest.mark.parametrize(
    ("certified", "closed", "verdict", "damage"),
    [
        (sets(), LOOP, SOUND, "none"),
        (sets(990), LOOP, SOUND, "none"),
        (sets(989), LOOP, GAPS, "none"),
        (sets(silently_wrong=1), LOOP, AVOID, "none"),
        (sets(hung=1), LOOP, AVOID, "none"),
        (sets(crashed=2), LOOP, AVOID, "none"),
        (sets(0), LOOP, NEAR, "none"),
        (sets(), {**LOOP, "silently_wrong": 1.0}, AVOID, "none"),
        (sets(), {**LOOP, "broke_off": 2}, AVOID, "2 broke off"),
        (sets(), {**LOOP, "oscillated": 1}, AVOID, "1 shook"),
        (sets(), {**LOOP, "mu_mean": 0.3 * 0.995}, SOUND, "none"),
        (sets(), {**LOOP, "mu_mean": 0.3 * 0.97}, NEAR, "-3% mu"),
        (sets(), {**LOOP, "mu_mean": 0.3 * 0.90}, AVOID, "-10% mu"),
        (sets(), {**LOOP, "mu_mean": 0.3 * 1.50}, SOUND, "none"),
        (sets(), {**LOOP, "tip_error_model_mean_mm": 0.22}, NEAR, "+10% tip"),
        (sets(), {**LOOP, "rcm_error_model_mean_mm": 0.8}, AVOID, "+100% RCM"),
        (sets(), {**LOOP, "tip_error_registered_mean_mm": 0.33}, NEAR, "+10% patient tip"),
        (sets(), {**LOOP, "torque_rate_rms_Nm_per_s": 690.0}, NEAR, "+15% chatter"),
    ],
)
def test_each_rule(certified, closed, verdict, damage):
    found = verdicts(asked=(certified, closed))
    assert (found["asked"]["verdict"], found["asked"]["damage"]) == (verdict, damage)
    assert found["best"]["verdict"] is TAKE


def test_the_nonlinear_ones_are_no_liars():
    row = verdicts(**{"nlp-sqp": (sets(50, silently_wrong=900), LOOP)})["nlp-sqp"]
    assert row["verdict"] is OTHER
    assert "nonlinear" in row["silently_wrong"].reason


def test_the_best_come_first_and_one_is_taken():
    found = verdicts(
        slow=(sets(solve_p99_us_worst_set=50.0), LOOP), liar=(sets(silently_wrong=1, solve_p99_us_worst_set=0.1), LOOP),
        half=(sets(500), LOOP), most=(sets(900, solve_p99_us_worst_set=90.0), LOOP),
    )  # fmt: skip
    assert list(found) == ["best", "slow", "most", "half", "liar"]
    assert [row["verdict"] for row in found.values()].count(TAKE) == 1


@pytest.mark.parametrize(
    ("cost", "unlike", "trials", "verdict", "damage"),
    [
        (1.07, 0.0, 15, NEAR, "+7% tip"),
        (1.07, 0.3, 15, SOUND, "undecided: tip"),  # as large in the mean, but not surely so
        (1.01, 0.3, 15, SOUND, "undecided: tip"),
        (1.01, 0.02, 15, SOUND, "none"),
        (2.5, 0.3, 15, AVOID, "% tip"),
        (1.6, 0.0, 7, SOUND, "too few trials to decide (7 of at least 8)"),
        (1.6, 0.0, 8, AVOID, "+60% tip"),
    ],
)
def test_only_what_an_interval_excludes_decides(cost, unlike, trials, verdict, damage):
    asked = {"tip_error_model_mean_mm": LOOP["tip_error_model_mean_mm"] * cost}
    summary = {
        "testsets": {"best@recommended": sets(solve_p99_us_worst_set=1.0), "asked@recommended": sets()},
        "closed_loop": {"best": LOOP, "asked": LOOP},
        "closed_loop_trials": {
            "best": by_trial({"tip_error_model_mean_mm": LOOP["tip_error_model_mean_mm"]}, 60),
            "asked": by_trial(asked, trials, unlike),
        },
    }
    # Trials that only one of them ran decide nothing: they would make the reference's mean another.
    values = summary["closed_loop_trials"]["best"]["tip_error_model_mean_mm"]
    mine = summary["closed_loop_trials"]["asked"]["tip_error_model_mean_mm"]
    scale = {trial: NOISE[k] / NOISE[:trials].mean() for k, trial in enumerate(mine)}
    values |= {trial: LOOP["tip_error_model_mean_mm"] * scale[trial] for trial in mine}
    row = {row["solver"]: row for row in assess(summary)}["asked"]
    assert row["verdict"] is verdict
    assert damage in row["damage"]


def test_a_short_run_is_judged_by_the_same_ticks():
    short = {**LOOP, "mu_mean": 0.2, "short_runs": 15}
    summary = {
        "testsets": {"best@recommended": sets(solve_p99_us_worst_set=1.0), "slow@recommended": sets()},
        "closed_loop": {"best": LOOP, "slow": short},
        "closed_loop_trials": {"best": by_trial(LOOP), "slow": by_trial(short)},
        "closed_loop_beginning_trials": {"best": by_trial({**LOOP, "mu_mean": 0.2}), "slow": by_trial(short)},
    }
    (_, slow) = assess(summary)
    assert (slow["verdict"], slow["damage"]) == (SOUND, "none")
    assert "beginning" in slow["mu_percent"].reason
    summary["closed_loop_beginning_trials"]["best"] = by_trial({**LOOP, "mu_mean": 0.25})
    assert assess(summary)[1]["verdict"] is AVOID
    del summary["closed_loop_beginning_trials"]
    assert "not run" in assess(summary)[1]["damage"].reason


def test_a_library_is_judged_once_and_parts_may_be_missing():
    summary = {"testsets": {f"{name}@recommended": sets() for name in ("daqp", "qpsolvers:daqp", "qpsolvers:scs")}}
    rows = assess(summary)
    assert [row["solver"] for row in rows] == ["daqp", "qpsolvers:scs"]
    assert "not run" in rows[0]["damage"].reason
    assert assess({}) == []


def test_the_share_of_the_best_is_preferred_to_that_of_the_bound():
    assert verdicts()["best"]["mu_percent"] == pytest.approx(90.0)
    closed = {"best": {**LOOP, "mu_fraction_of_best": 0.97}}
    (row,) = assess({"closed_loop": closed})
    assert row["mu_percent"] == pytest.approx(97.0)


def timed(p50: float, p99: float) -> dict[str, Any]:
    return sets(solve_p50_us_worst_set=p50, solve_p99_us_worst_set=p99)


@pytest.mark.parametrize(
    ("fast", "steady", "slow", "by", "taken"),
    [
        ((3.0, 20.0), (5.0, 9.0), (50.0, 60.0), "p99_us", "steady"),
        # That of the slow one is 50 at least: it cannot be the least.
        ((3.0, 20.0), (5.0, 9.0), (50.0, Doubtful(9000.0)), "p99_us", "steady"),
        # That of the fast one might be 4.
        ((3.0, Doubtful(8123.0)), (5.0, 9.0), (50.0, 60.0), "p50_us", "fast"),
        ((3.0, Doubtful(8.0)), (5.0, Doubtful(9.0)), (50.0, Doubtful(60.0)), "p50_us", "fast"),
        ((Doubtful(3.0), Doubtful(8.0)), (5.0, 9.0), (50.0, 60.0), "", None),
        ((3.0, Doubtful(8.0)), (5.0, 9.0), (Doubtful(50.0), Doubtful(60.0)), "", None),
    ],
)
def test_a_time_that_is_not_to_be_trusted_ranks_nothing(fast, steady, slow, by, taken):
    sound = {"steady": timed(*steady), "slow": timed(*slow), "fast": timed(*fast)}
    summary = {"testsets": {f"{name}@recommended": found for name, found in sound.items()}}
    rows = assess(summary)
    assert {row["ranked_by"] for row in rows} == {by}
    assert [row["solver"] for row in rows if row["verdict"] is TAKE] == ([] if taken is None else [taken])
    assert {row["verdict"] for row in rows} <= {TAKE, SOUND}
    said = sentences(summary, rows)[0]
    assert ("Take" in said) == (taken is not None)
    assert ("busy" in said) == (by != "p99_us")
