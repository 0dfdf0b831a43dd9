"""`mo.compare` runs the same trials with every solver."""

from itertools import product
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import ScenarioError, SolverError, UnknownNameError
from moc_opt.solvers.base import Solution, Status
from moc_opt.study.compare import Comparison
from moc_opt.study.trials import placed
from moc_opt.trace.trace import about


def standing(name="standing", fails=None):
    """Return a solver that answers x = 0, or whose start raises ``fails``."""
    session = SimpleNamespace(solve=lambda qp: Solution(np.zeros(len(qp.lower)), None, Status.SOLVED))
    return SimpleNamespace(name=name, supports=lambda qp: None, start=Mock(side_effect=fails, return_value=session))


SHORT = mo.Scenario(duration_s=0.3, bound_samples=0)
BRIEF = mo.Scenario(duration_s=0.02, bound_samples=0)


def test_every_solver_runs_the_same_trials():
    said = []
    found = mo.compare(["exact", standing()], SHORT, trials=2, seed=4, watch=said.append)
    assert (said[0], len(said)) == ("trial 1 of 2, dcac", 6)
    assert found.solvers == ["dcac", "exact", "standing"]
    assert [(row["seed"], row["solver"]) for row in found.rows] == [*product((4, 5), found.solvers)]
    starts = [[row["mu_mean"] for row in found.rows if row["seed"] == seed] for seed in (4, 5)]
    for values in starts:  # in one trial all solvers start in the same pose, so mu differs little
        assert np.ptp(values) < 0.05 * np.mean(values)
    assert abs(np.mean(starts[0]) - np.mean(starts[1])) > 1e-3
    mine, base = ([row["mu_mean"] for row in found.rows if row["solver"] == name] for name in ("exact", "dcac"))
    summary = found.summary()
    assert summary["exact"]["mu_gain_percent"] == pytest.approx(100 * (np.mean(mine) / np.mean(base) - 1))
    gains = [row["mu_gain_percent"] for row in found.rows if row["solver"] == "exact"]
    assert gains == pytest.approx([100 * (mu / of - 1) for mu, of in zip(mine, base, strict=True)])
    assert (summary["exact"]["verified"], summary["exact"]["silently_wrong"]) == (100.0, 0)
    assert summary["standing"]["verified"] < 100.0
    assert "verified" not in summary["dcac"]
    assert [row["trials"] for row in found.table.rows] == ["2", "2", "2"]
    assert found.to_pandas()["mu_mean"].tolist() == [row["mu_mean"] for row in found.rows]
    assert len(found.plot("mu_mean").data) == 3
    assert found.plot("mu_mean").layout.xaxis.title.text == "mu_mean [m³]"
    with pytest.raises(UnknownNameError, match="unknown metric 'mu_maen': did you mean 'mu_mean'"):
        found.plot("mu_maen")


@pytest.mark.parametrize(("solvers", "more", "error", "message"), [
    (["exakt"], {}, UnknownNameError, "did you mean 'exact'"), ([], {}, SolverError, "no solver to compare"),
    ([standing(), standing()], {}, SolverError, "called 'standing': name each once, or give a mapping"),
    ([object()], {}, SolverError, "is no solver: it has no method `supports` and no `start`"),
    ({1: "exact"}, {}, SolverError, "1 cannot name a solver"),
    (7, {}, SolverError, r"solvers = 7: give a list of names or solvers"),
    (["exact"], {"trials": 0}, ScenarioError, "trials = 0: give an integer from 1"),
    (["exact"], {"scenario": mo.Scenario(control={"law": "dcac"})}, ScenarioError, "law = 'dcac' has no solver"),
])  # fmt: skip
def test_wrong_arguments_are_refused_before_any_run(solvers, more, error, message):
    with pytest.raises(error, match=message):
        mo.compare(solvers, **more)


def test_runs_of_a_solver_that_cannot_start_are_reported_as_failed():
    found = mo.compare([standing("broken", RuntimeError("no licence here")), "exact"], BRIEF, trials=2)
    errors = {(row["ended"], *row["error"].split(" (mock.py")) for row in found.rows if row["solver"] == "broken"}
    said = "ControlError: solver 'broken' cannot run in this controller: RuntimeError: no licence here"
    assert [one[:-1] for one in errors] == [("failed", said)]
    assert not {"mu_mean", "mu_gain_percent"} & set(found.summary()["broken"])
    assert [row[:2] for row in found.table.texts()[1]] == [("dcac", "2"), ("! broken", "0 of 2"), ("exact", "2")]
    assert found.table.caption.startswith("!: Trials of broken that failed or were stopped: 2; the first: Control")


@pytest.mark.parametrize(("answers", "message"), [
    ({"side_effect": ValueError("oops")}, "ValueError: oops (mock.py, line "),
    ({"return_value": [0.0]}, "solve returned a list: return a Solution."),
])  # fmt: skip
def test_exceptions_and_malformed_answers_are_reported_below_the_table(answers, message):
    bad = standing("bad")
    bad.start.return_value.solve = Mock(**answers)
    caption = mo.compare([bad], BRIEF, trials=2).table.caption
    assert f"malformed answers of bad: 2; in the first of them: 10 ticks, first at 0.000 s: {message}" in caption
    assert "The supervisor replaced 100 % of the answers of bad, so the means say little about bad." in caption
    assert about(mo.run(BRIEF, solver=bad))["solver"] == "bad", "the trace names the solver that ran"


def test_missing_start_pose_fails_a_trial_but_raises_in_the_first_trial(monkeypatch):
    def only_even(trial):
        if trial.seed % 2:
            raise ScenarioError("no start")
        return placed(trial)

    monkeypatch.setattr("moc_opt.study.compare.placed", only_even)
    found = mo.compare(["exact"], BRIEF, trials=3)
    assert [row["error"] for row in found.rows if row["solver"] == "exact"] == [None, "ScenarioError: no start", None]
    assert (found.summary()["exact"]["whole"], found.summary()["exact"]["trials"]) == (2, 3)
    with pytest.raises(ScenarioError, match="no start"):
        mo.compare(["exact"], BRIEF, trials=1, seed=1)


def test_interrupt_keeps_the_completed_trials():
    def watch(words):
        if words == "trial 3 of 4, exact":
            raise KeyboardInterrupt

    found = mo.compare(["exact"], BRIEF, 4, watch=watch)
    assert not found.complete
    runs = [(row["seed"], row["solver"]) for row in found.rows]
    assert runs == [(k, name) for k in (0, 1) for name in ("dcac", "exact")]
    assert found.table.caption.startswith("Interrupted: 2 of 4 trials.")
    with pytest.raises(KeyboardInterrupt):
        mo.compare(["exact"], BRIEF, 4, watch=lambda words: (_ for _ in ()).throw(KeyboardInterrupt()))


TIP = {"dcac": (0.02, 0.3), "exact": (0.1, 0.15), "qpsolvers:quadprog": (0.05, 0.05), "nlp-sqp": (0.05, 0.05)}


def compared(trials):
    """Return a comparison in which `exact` raises small tip errors and lowers large ones."""
    rows = [{
        "solver": name, "seed": seed, "ended": "completed", "asked": 4 * (name != "dcac"),
        "solve_p50_us": 12.34, "solve_p99_us": 345.6, "verified_solved": 4, "silently_wrong": 0,
        "mu_mean": (0.2123 + 0.01 * seed) * (1.0 if name == "dcac" else 1.1 + 0.001 * seed),
        "tip_error_model_mean_mm": tip[seed % 2], "tip_error_registered_mean_mm": 0.05 + 0.01 * seed,
        "rcm_error_model_mean_mm": 0.3 - 0.02 * seed, "rcm_error_registered_mean_mm": 0.3 + 0.01 * seed,
    } for seed, (name, tip) in product(range(trials), TIP.items())]  # fmt: skip
    return Comparison(rows, list(TIP), SHORT)


def test_undecided_change_is_marked_with_a_question_mark():
    wide, name = compared(9), "tip_error_model_change_percent"
    found, row = wide.summary()["exact"], wide.table.rows[1]
    assert found[name] < 0.0 < found[f"{name}_of_ratios"]
    assert row[name] == f"{found[name]:+.3g} [{found[f'{name}_low']:+.3g}, {found[f'{name}_high']:+.3g}]?"
    assert row["mu_gain_percent"].endswith("]")


@pytest.mark.parametrize(("trials", "decided"), [(7, False), (8, True)])
def test_changes_need_eight_trials(trials, decided):
    table = compared(trials).table
    assert ("mu_gain_percent" in {column.key for column in table.columns}) is decided
    assert {"[" in table.rows[1]["mu_mean"], "undecided" in table.caption, "or more" not in table.caption} == {decided}
    assert max(map(len, repr(compared(trials)).splitlines())) <= 200


def test_answers_of_nonlinear_solvers_are_not_judged():
    found = mo.compare(["nlp-sqp", "exact"], mo.Scenario(duration_s=0.04, bound_samples=0), trials=1)
    summary = found.summary()
    assert {"solve_p50_us", "silently_wrong", "verified"} & set(summary["nlp-sqp"]) == {"solve_p50_us"}
    assert summary["exact"]["verified"] == 100.0
    assert "nlp-* solve a nonlinear problem" in found.table.caption
    alone = Comparison([r for r in found.rows if r["solver"] != "nlp-sqp"], ["dcac", "exact"], SHORT)
    assert "nlp-" not in alone.table.caption
