"""Verdicts follow their stated rules: who lies, hangs, shakes or costs is avoided; who is right is not."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.solver_study.verdicts import AVOID, GAPS, NEAR, OTHER, SOUND, TAKE, assess

LOOP = {
    "mu_mean": 0.3, "tip_error_model_mean_mm": 0.2, "rcm_error_model_mean_mm": 0.4, "torque_rate_rms_Nm_per_s": 600.0,
    "runs": 15, "mu_fraction_of_bound": 0.9,
}  # fmt: skip


def sets(right: int = 1000, **more: Any) -> dict[str, Any]:
    found = {"solves": 1000, "right": right, "claimed_solved": right, "silently_wrong": 0, "hung": 0, "crashed": 0}
    return {**found, "solve_p50_us_worst_set": 5.0, "solve_p99_us_worst_set": 9.0, "relative_max": 1e-9, **more}


def verdicts(**solvers: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, Any]:
    """Solver -> its row, beside one that is sound and fastest."""
    every = {"best": (sets(solve_p99_us_worst_set=1.0), LOOP), **solvers}
    summary = {
        "testsets": {f"{name}@recommended": certified for name, (certified, _) in every.items()},
        "closed_loop": {"dcac": LOOP, **{name: closed for name, (_, closed) in every.items() if closed}},
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


def test_a_short_run_is_judged_by_the_same_ticks():
    short = {**LOOP, "mu_mean": 0.2, "short_runs": 15}
    summary = {
        "testsets": {"best@recommended": sets(solve_p99_us_worst_set=1.0), "slow@recommended": sets()},
        "closed_loop": {"best": LOOP, "slow": short},
        "closed_loop_beginning": {"best": {**LOOP, "mu_mean": 0.2}, "slow": short},
    }
    (_, slow) = assess(summary)
    assert (slow["verdict"], slow["damage"]) == (SOUND, "none")
    assert "beginning" in slow["mu_percent"].reason
    summary["closed_loop_beginning"]["best"]["mu_mean"] = 0.25
    assert assess(summary)[1]["verdict"] is AVOID
    del summary["closed_loop_beginning"]
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
