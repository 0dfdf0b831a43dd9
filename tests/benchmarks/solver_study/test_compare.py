"""What is read off two tables: rank correlations and their words, distances of duals, performance profiles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from benchmarks.solver_study import compare
from benchmarks.solver_study.cells import load
from benchmarks.solver_study.compare import (
    correlations,
    disagreements,
    dual_distances,
    profile,
    ranks,
    verdict,
)
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import create
from moc_opt.study.statistics import LEAST_TRIALS

NAMES = [f"solver {i}" for i in range(8)]


def tables(primal, mu, tip):
    opened = {name: {"primal_p50": x} for name, x in zip(NAMES, primal, strict=True)}
    closed = {name: {"mu_mean": a, "tip_error_model_mean_mm": b} for name, a, b in zip(NAMES, mu, tip, strict=True)}
    return opened, closed


def test_what_is_better_in_both_correlates_by_one():
    residual = 10.0 ** np.arange(-9.0, -1.0)
    found = correlations(*tables(residual, -residual, -residual))
    assert found["primal_p50 ~ mu_mean"]["rank_correlation"] == pytest.approx(1.0)
    assert found["primal_p50 ~ tip_error_model_mean_mm"]["rank_correlation"] == pytest.approx(-1.0)
    said = verdict(found, 15)
    assert "anipulability follows" in said
    assert "goes against" in said
    assert "too few trials to decide (7 of at least 8)" in verdict(found, LEAST_TRIALS - 1)
    assert verdict(found, LEAST_TRIALS) == said


def test_it_is_spearman_s_coefficient():
    rng = np.random.default_rng(3)
    x, mu = rng.normal(size=8), rng.normal(size=8)
    found = correlations(*tables(x, mu, mu))["primal_p50 ~ mu_mean"]
    expected = stats.spearmanr(-x, mu)
    assert found["rank_correlation"] == pytest.approx(expected.statistic)
    assert found["p_value"] == pytest.approx(expected.pvalue)


def test_chance_is_called_no_prediction():
    opened, closed = tables([1, 2, 3, 4, 5, 6, 7, 8], [4, 8, 1, 6, 3, 7, 2, 5], [5] * 8)
    found = correlations(opened, closed)
    assert list(found) == ["primal_p50 ~ mu_mean"]  # a table without spread has no ranks
    assert "no residual of open loop predicts manipulability" in verdict(found, 15).lower()
    assert "Too few" in verdict({}, 15)


def test_disagreements_name_who_and_by_how_much():
    mu = np.arange(8.0)[::-1].copy()
    mu[[0, 7]] = mu[[7, 0]]
    found = disagreements(*tables(np.arange(8.0), mu, mu), "primal_p50", "mu_mean", count=2)
    assert {d["name"] for d in found} == {"solver 0", "solver 7"}
    assert {(d["open_rank"], d["closed_rank"]) for d in found} == {(1.0, 8.0), (8.0, 1.0)}
    assert any("worse in closed loop" in d["words"] and "place 1 of 8" in d["words"] for d in found)
    same = np.arange(8.0)
    assert disagreements(*tables(same, -same, -same), "primal_p50", "mu_mean") == []


def test_noise_decides_no_rank():
    mu = 0.3 * (1.0 + 1e-4 * np.array([3, 1, 4, 1, 5, 9, 2, 6]))
    assert correlations(*tables(np.arange(8.0), mu, mu)) == {}
    mu[0] = 0.2
    assert "primal_p50 ~ mu_mean" in correlations(*tables(np.arange(8.0), mu, mu))


def test_missing_figures_leave_a_name_out():
    opened, closed = tables(np.arange(8.0), np.arange(8.0), np.arange(8.0))
    opened["solver 3"]["primal_p50"] = None
    assert correlations(opened, closed)["primal_p50 ~ mu_mean"]["solvers"] == 7


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_ranks_begin_at_the_best(values):
    low, high = ranks(values, False), ranks(values, True)
    np.testing.assert_allclose(low + high, len(values) + 1.0)
    assert low[int(np.argmin(values))] == low.min()


# --- duals ---


@pytest.fixture(scope="module")
def problems():
    return [NullSpaceQP.from_row(np.array(row)) for row in load("circle", 16).rows]


def duals(problems, name, rows):
    session = create(name, rows=rows).start(problems[0])
    return np.array([session.solve(qp).y for qp in problems])


def test_six_rows_leave_a_direction_free_and_five_do_not(problems):
    six = dual_distances(problems, {name: duals(problems, name, 6) for name in ("osqp", "piqp", "clarabel")})
    for gap in six.values():  # whatever they differ by across the free direction, no solver decides along it
        assert gap["problems"] == len(problems)
        assert gap["max"] >= gap["p50"] >= 0.0
    y = duals(problems, "osqp", 5)
    u = np.array([np.linalg.svd(qp.J_tip - qp.J_wrist)[0][:, 2] for qp in problems])
    moved = y + 3e-4 * np.concatenate([u, -u], axis=1)
    found = dual_distances(problems, {"a": y, "b": moved})["a | b"]
    scale = np.median([3e-4 * np.sqrt(2.0) / (qp.c2 * np.abs(qp.grad_mu).max()) for qp in problems])
    assert found["along_p50"] == pytest.approx(scale, rel=1e-6)
    assert found["across_max"] < 1e-9
    # and both are duals of the same answer
    x = create("exact").start(problems[0]).solve(problems[0]).x
    residuals = [problems[0].residuals(x, dual[0]).natural for dual in (y, moved)]
    assert residuals[0] == pytest.approx(residuals[1], abs=1e-9)


def test_duals_that_were_not_given_are_left_out(problems):
    y = duals(problems, "piqp", 5)
    none = np.full_like(y, np.nan)
    assert dual_distances(problems, {"a": y, "b": none}) == {}
    half = y.copy()
    half[::2] = np.nan
    assert dual_distances(problems, {"a": y, "b": half})["a | b"]["problems"] == len(problems) // 2
    assert "Fewer than two" in compare.dual_verdict({}, {})


# --- profiles ---


def test_a_profile_begins_with_wins_and_ends_with_what_was_solved():
    costs = {"fast": np.array([1.0, 1.0, 1.0, np.inf]), "slow": np.array([2.0, 2.0, 0.5, 8.0])}
    tau, shares = profile(costs)
    assert tau[0] == 1.0
    assert (shares["fast"][0], shares["fast"][-1]) == (0.5, 0.75)
    assert (shares["slow"][0], shares["slow"][-1]) == (0.5, 1.0)
    for share in shares.values():
        assert (np.diff(share) >= 0.0).all()


def test_a_problem_that_nobody_solved_counts_against_all():
    _, shares = profile({"a": np.array([1.0, np.inf]), "b": np.array([np.inf, np.inf])})
    assert shares["a"][-1] == 0.5
    assert shares["b"][-1] == 0.0
