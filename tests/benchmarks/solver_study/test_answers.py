"""Answers to sets: what is counted as what, and that a solver which hangs or crashes is recorded and no more."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from benchmarks.solver_study import growth, settings
from benchmarks.solver_study.answers import Data, Limits, Part, ask, time
from benchmarks.solver_study.cells import Cell, load, time_figures, totals
from benchmarks.solver_study.settings import SETTINGS, TIGHT_OPTIONS, SolverSetting, solver_settings
from moc_opt.figures.notation import Doubtful
from moc_opt.scenario import make_solver
from moc_opt.solvers import available
from moc_opt.solvers.registry import accepts
from moc_opt.study import Kept, run
from moc_opt.study.timing import Disturbance
from tests import broken_solvers

LIMITS = Limits(patience_s=1.0, rounds=2, seconds=0.2, cold=4)
EXACT = SolverSetting("exact", "recommended", {}, "")


ONE = partial(run, workers=1)


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """Workers that find the broken solvers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(broken_solvers.install(tmp_path_factory.mktemp("plugin"))))
        assert {name: available().get(name, "") for name in broken_solvers.NAMES} == dict.fromkeys(
            broken_solvers.NAMES
        )
        yield ONE


@pytest.fixture(scope="module")
def some():
    """Sixteen problems, of which some are infeasible."""
    return load("infeasible", 8)


def cell(setting, data, warm=True):
    (part,) = ask(ONE, [(setting, data)], LIMITS, warm)
    return Cell(setting, data, part)


def timed(setting, data, run=ONE):
    (part,) = time(run, [(setting, data)], LIMITS)
    return part


def test_exact_is_right_on_every_set(some):
    for data in (load("circle", 16), some, load("inconsistent-1e-4", 8), load("jumps", 8)):
        counts = cell(EXACT, data).counts()
        assert counts["verified_solved"] == counts["optima_asked"]
        assert (counts["refused_inconsistent"] > 0) == data.name.startswith("inconsistent")
        assert counts["infeasible_right"] == counts["infeasible_asked"]
        assert counts["silently_wrong"] == counts["failed"] == counts["infeasible_wrong"] == 0


def test_a_solver_that_hangs_is_stopped_and_recorded(broken):
    data = load("circle", 8)
    found = cell(SolverSetting("hangs", "recommended", {"at": 3}, ""), data)
    # a fresh session after each hang: the fourth and the eighth problem; then the rest is left alone
    assert np.flatnonzero(found.status == "hung").tolist() == [3, 7]
    assert (found.status[8:] == "not asked").all()
    counts = found.counts()
    assert (counts["hung"], counts["claimed_solved"], counts["not_asked"]) == (2, 6, 8)
    assert not found.complete
    assert time_figures(timed(found.setting, data))["timed_solves"] == 0


def test_a_solver_that_hangs_everywhere_is_given_up(broken):
    sets = [load(name, 32) for name in ("circle", "spiral", "sinusoid", "random", "jumps")]
    limits = Limits(patience_s=0.5, rounds=2, seconds=0.1, cold=2)
    parts = ask(broken, [(SolverSetting("hangs", "recommended", {"at": 0}, ""), data) for data in sets], limits)
    status = [part.arrays["status"].tolist() for part in parts]
    assert status[:3] == [["hung", "hung", "not asked", "not asked"]] * 3
    assert "hung" not in status[3][1:], "one set more may have been under way"
    assert status[4] == ["not asked"] * 4


def test_a_solver_that_hangs_while_it_is_set_up_is_not_asked_again(broken):
    data = load("circle", 32)
    limits = Limits(patience_s=0.5, setup_s=2.0)
    (part,) = ask(broken, [(SolverSetting("stuck", "recommended", {}, ""), data)], limits)
    assert part.arrays["status"].tolist() == ["hung", "not asked", "not asked", "not asked"]
    assert "while setting up" in part.values["events"][0]


def test_a_crash_is_recorded_with_its_signal(broken):
    found = cell(SolverSetting("crashes", "recommended", {"at": 1}, ""), load("circle", 16))
    assert np.flatnonzero(found.status == "crashed").tolist() == [1, 3]
    assert all("SIGSEGV" in event for event in found.part.values["events"])


def test_an_exception_costs_one_answer(broken):
    found = cell(SolverSetting("raises", "recommended", {"at": 2}, ""), load("circle", 16))
    assert np.flatnonzero(found.status == "raised").tolist() == [2, 5]
    counts = found.counts()
    assert (counts["raised"], counts["failed"], counts["verified_solved"]) == (2, 2, 6)


@pytest.mark.parametrize(("name", "reason"), [("quits", "SystemExit: no more"), ("empty", "start returned None")])
def test_a_solver_that_cannot_even_be_started_is_a_row_with_its_reason(broken, name, reason):
    found = cell(SolverSetting(name, "recommended", {}, ""), load("circle", 64))
    assert reason in found.refused
    assert found.counts()["not_asked"] == 2


def test_a_solver_that_starts_only_once_costs_the_answers_after_its_exception(broken):
    found = cell(SolverSetting("once", "recommended", {"at": 1}, ""), load("circle", 32))
    assert found.status.tolist() == ["solved", "raised", "raised", "raised"]
    assert "RuntimeError: only once" in found.part.values["events"][-1]


def test_an_answer_without_form_costs_one_answer(broken):
    found = cell(SolverSetting("untyped", "recommended", {}, ""), load("circle", 64))
    assert found.status.tolist() == ["raised", "raised"]
    assert "solve returned a NoneType" in found.part.values["events"][0]


def test_a_solver_that_refuses_is_not_asked():
    found = cell(SolverSetting("quadprog", "recommended", {}, ""), load("circle-rho0", 16))
    assert "regularization" in found.refused
    assert found.counts()["not_asked"] == 8
    assert cell(SolverSetting("no-such", "recommended", {}, ""), load("circle", 64)).refused.startswith(
        "UnknownName"
    )


def made(status, x, feasible, rows):
    part = Part(
        {"reason": "", "events": []},
        {
            "status": np.array(status),
            "iterations": np.ones(len(status), int),
            "x": x,
            "y": np.full((len(x), 6), np.nan),
        },
    )
    return Cell(EXACT, Data("made", rows, rows, np.array(feasible)), part)


def test_claims_are_counted_by_the_certificate_and_the_judge():
    kept = load("circle", 32)
    from benchmarks.subproblems.testset import TestSet

    x = TestSet.load("circle").x[::32].copy()
    x[1] = 0.0  # claimed, and wrong
    found = made(["solved", "solved", "infeasible", "max_iter"], x, [True] * 4, kept.rows).counts()
    assert (found["claimed_solved"], found["verified_solved"], found["silently_wrong"]) == (2, 1, 1)
    assert (found["infeasible_right"], found["infeasible_wrong"], found["failed"]) == (0, 1, 2)
    assert found["verified"] == 3  # the last two are right, whatever was claimed
    found = made(["infeasible", "solved", "max_iter", "solved"], x, [False] * 4, kept.rows).counts()
    assert (found["infeasible_right"], found["infeasible_wrong"]) == (1, 0)
    assert (found["silently_wrong"], found["failed"]) == (2, 1)


def test_times_are_measured_warm_and_cold():
    data = load("circle", 8)
    figures = time_figures(timed(EXACT, data))
    assert figures["timed_solves"] == 2 * 16
    for prefix in ("solve", "cold", "setup"):
        assert (
            0.1
            < figures[f"{prefix}_p50_us"]
            <= figures[f"{prefix}_p99_us"]
            <= figures[f"{prefix}_p99_9_us"]
            < 1e5
        )


@pytest.mark.parametrize("trusted", [True, False])
def test_times_are_kept_where_they_are_trusted(tmp_path, monkeypatch, trusted):
    monkeypatch.setattr(Disturbance, "trusts", lambda *_: trusted)
    data, do = load("circle", 32), partial(ONE, kept=Kept(tmp_path / "jobs"))
    first = timed(EXACT, data, do)
    assert first.values["warm"]["calls"] == first.arrays["solve_us"].size
    found = time_figures(first)
    assert isinstance(found["solve_p99_us"], Doubtful) is not trusted
    assert isinstance(found["cold_p50_us"], Doubtful) is not trusted
    again = timed(EXACT, data, do)
    assert np.array_equal(again.arrays["solve_us"], first.arrays["solve_us"]) is trusted
    if trusted:
        assert time_figures(again) == found


def test_totals_add_counts_and_quote_the_worst_set():
    cells = [cell(EXACT, load(name, 32)) for name in ("circle", "infeasible")]
    others = {f"{name}_us": np.array([us]) for name, us in (("setup", 1.0), ("cold", 2.0), ("update", 3.0))}
    slow = {"solve_us": np.full((2, 4), 7.0), **others}
    fast = {**slow, "solve_us": np.full((2, 4), 3.0)}
    found = totals(cells, {"circle": Part({}, slow), "infeasible": Part({}, fast)})
    assert found["solves"] == 8
    assert found["solve_p50_us_worst_set"] == 7.0
    assert not any("mean" in name for name in found)


def test_cold_sessions_know_nothing_of_each_other():
    """The network forgets: cold, every answer starts from rest."""
    data = load("circle", 16)
    setting = SolverSetting("rnn", "x", {"steps": 5}, "")
    warm, cold = cell(setting, data), cell(setting, data, warm=False)
    assert np.abs(warm.part.arrays["x"][-1] - cold.part.arrays["x"][-1]).max() > 1e-3
    np.testing.assert_array_equal(warm.part.arrays["x"][0], cold.part.arrays["x"][0])


# --- settings ---


@pytest.mark.parametrize(
    "setting", solver_settings([n for n, why in available().items() if why is None]), ids=lambda e: e.label
)
def test_every_setting_exists_and_has_its_reason(setting, robot):
    assert len(setting.reason) > 10
    solver = make_solver(setting.solver, robot, **setting.options)
    assert solver.name == setting.solver
    assert all(accepts(setting.solver, option) for option in setting.options)


def test_the_table_names_no_solver_that_does_not_exist():
    assert set(SETTINGS) <= set(available())
    assert {f"qpsolvers:{name}" for name in TIGHT_OPTIONS} <= set(available())


def test_the_page_shows_the_table_as_it_is():
    """python -m benchmarks.solver_study.settings prints it; solvers that are missing here are missing there."""
    page = (Path(__file__).resolve().parents[3] / "docs" / "solvers.md").read_text(encoding="utf-8")
    shown = page.partition("<!-- settings -->\n")[2].partition("\n<!-- settings end -->")[0].splitlines()
    assert len(shown) > 30
    assert [line for line in settings.as_markdown().splitlines() if line not in shown] == []


def test_recommended_is_what_an_adapter_does_untold():
    by_label = {e.label: settings.effective(e) for e in solver_settings(["osqp", "qpsolvers:osqp", "exact"])}
    assert by_label["osqp@recommended"]["cost_scale"] == 100.0
    assert by_label["osqp@default"]["rows"] == 6
    assert by_label["qpsolvers:osqp@recommended"]["eps_abs"] == 1e-8
    assert "eps_abs" not in by_label["qpsolvers:osqp@default"]


def test_overrides_change_the_recommended_setting_alone():
    found = {e.name: e.options for e in solver_settings(["osqp"], {"osqp": {"eps": 0.5}})}
    assert found["recommended"] == {"eps": 0.5}
    assert found["default"]["eps"] == 1e-3


# --- joints ---


@pytest.mark.parametrize("n", [7, 9])
def test_arms_with_more_joints_are_feasible_and_answered(n):
    data = growth.sequence(n, count=6)
    assert data.n == n
    assert data.feasible.all()
    assert cell(EXACT, data).counts()["verified_solved"] == 6


def test_the_exponent_is_that_of_a_power_law():
    times = {n: {"solve_p50_us": 3.0 * n**2} for n in (7, 9, 14)}
    found = growth.growth(times)
    assert found["exponent"] == pytest.approx(2.0)
    assert found["14_over_7"] == pytest.approx(4.0)
    assert growth.growth({7: {}}) == {}
