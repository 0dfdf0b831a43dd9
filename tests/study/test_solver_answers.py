"""How the study counts a solver's answers."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from moc_opt.scenario import make_solver
from moc_opt.solvers import available
from moc_opt.study import Kept, run
from moc_opt.study.solver_answers import Answer, Answers, Limits, ask, share_right, time, totals
from moc_opt.study.solver_settings import SETTINGS, SolverSetting, effective, solver_settings
from moc_opt.study.testsets import NAMES, TestSet
from tests import broken_solvers

LIMITS = Limits(patience_s=1.0, rounds=2, seconds=0.2, cold=4)
EXACT = SolverSetting("exact", "recommended", {}, "")
ONE = partial(run, workers=1)


@pytest.fixture(scope="module", autouse=True)
def broken(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(broken_solvers.install(tmp_path_factory.mktemp("plugin"))))
        assert {name: available().get(name, "") for name in broken_solvers.NAMES} == dict.fromkeys(broken_solvers.NAMES)
        yield


def breaking(name: str, **options: Any) -> SolverSetting:
    return SolverSetting(name, "recommended", options, "")


def test_exact_is_right_on_every_set():
    for found in ask(ONE, [(EXACT, TestSet.load(name)) for name in NAMES], LIMITS):
        counts, name = found.counts(), found.problems.name
        spared = 2 if name == "near-singular" else 0  # on two problems, rounding decides whether `exact` is right
        assert counts["solves"] == 128
        assert counts["verified_solved"] + counts["failed"] == counts["optima_asked"]
        assert counts["failed"] <= spared
        contradicts = name in ("inconsistent-1e-6", "inconsistent-1e-4")
        assert counts["refused_inconsistent"] == contradicts * counts["feasible"]
        assert counts["infeasible_right"] == counts["infeasible_asked"] == 128 - counts["feasible"]
        assert counts["silently_wrong"] == counts["infeasible_wrong"] == 0


@pytest.mark.parametrize(("setting", "every", "status", "said"), [
    (breaking("hangs", at=1), 32, ["solved", "hung"] + ["not asked"] * 2, "no answer within"),
    (breaking("stuck"), 32, ["hung"] + ["not asked"] * 3, "problem 0, while setting up"),
    (breaking("crashes", at=1), 32, ["solved", "crashed"] + ["not asked"] * 2, "SIGSEGV"),
    (breaking("once", at=1), 32, ["solved", "raised", "raised", "raised"], "problem 1: ZeroDivisionError"),
    (breaking("untyped"), 64, ["raised", "raised"], "solve returned a NoneType"),
    (breaking("quits"), 64, ["refused", "refused"], "SystemExit: no more"),
    (breaking("no-such"), 64, ["refused", "refused"], "UnknownName"),
], ids=lambda value: value.solver if isinstance(value, SolverSetting) else "")  # fmt: skip
def test_every_answer_of_a_broken_solver_has_a_status(setting, every, status, said):
    limits = Limits(patience_s=1.0, setup_s=4.0)
    (found,) = ask(ONE, [(setting, TestSet.load("circle").thinned(every))], limits)
    assert found.status.tolist() == status
    assert said in " ".join([found.refused, *found.events])
    counts = found.counts()
    assert counts["not_asked"] == sum(word in ("not asked", "refused") for word in status)
    assert counts["verified_solved"] == status.count("solved")
    assert {word: counts[word] for word in ("hung", "crashed", "raised")} == {
        word: status.count(word) for word in ("hung", "crashed", "raised")
    }
    assert found.summary().get("trouble", found.refused) != ""


def test_solver_is_not_asked_again_after_it_hung_on_several_sets():
    sets = [TestSet.load(name).thinned(64) for name in ("circle", "spiral", "sinusoid", "random", "jumps")]
    found = ask(ONE, [(breaking("hangs", at=0), data) for data in sets], Limits(patience_s=0.5))
    status = [one.status.tolist() for one in found]
    assert (status[:3], status[4]) == ([["hung", "not asked"]] * 3, ["not asked"] * 2)


def made(setting: SolverSetting, problems: TestSet, status: list[str], x: Any) -> Answers:
    given = [Answer(word, 1, row, np.full(6, np.nan)) for word, row in zip(status, x, strict=True)]
    return Answers(setting, problems, ["", *given])


@pytest.mark.parametrize(("feasible", "status", "expected"), [
    (True, ["solved", "solved", "infeasible", "max_iter"],
     {"claimed_solved": 2, "verified_solved": 1, "silently_wrong": 1, "infeasible_wrong": 1, "failed": 2}),
    (False, ["infeasible", "solved", "max_iter", "solved"],
     {"infeasible_right": 1, "infeasible_wrong": 0, "silently_wrong": 2, "failed": 1, "right": 1}),
])  # fmt: skip
def test_reported_status_is_checked(feasible, status, expected):
    rows, x = (array[::32].copy() for array in (TestSet.load("circle").rows, TestSet.load("circle").x))
    x[1] = 0.0  # this x is wrong, but reported as solved
    counts = made(EXACT, TestSet("made", rows, x, np.full(4, feasible)), status, x).counts()
    assert {name: counts[name] for name in expected} == expected
    assert counts["right"] == counts["verified_solved"] + counts["infeasible_right"]
    assert counts["optima_asked"] + counts["infeasible_asked"] + counts["refused_inconsistent"] == counts["solves"]


@pytest.mark.parametrize(("rows", "refused"), [(6, 7), (5, 0)])
def test_refusing_six_inconsistent_equations_is_neither_right_nor_wrong(rows, refused):
    """With `rows` = 5, the solver gets five equations that do not contradict each other, so refusing is wrong."""
    problems = TestSet.load("inconsistent-1e-4").thinned(16)
    x = TestSet.load("inconsistent-1e-4").x[::16].copy()
    x[1:] = np.nan
    setting = SolverSetting("osqp", "recommended", {"rows": rows}, "")
    found = made(setting, problems, ["solved"] + ["infeasible"] * 7, x)
    counts = found.counts()
    assert (counts["right"], counts["verified_solved"], counts["optima_asked"]) == (1, 1, 8 - refused)
    assert (counts["refused_inconsistent"], counts["inconsistent_asked"]) == (refused, 8 if rows == 6 else 0)
    assert counts["infeasible_wrong"] == counts["failed"] == 7 - refused
    assert share_right(totals([found], [])) == 1 / (8 - refused)


def test_cold_sessions_are_independent():
    """Every cold solve of the network `rnn` starts from rest."""
    data, setting = TestSet.load("circle").thinned(16), SolverSetting("rnn", "x", {"steps": 5}, "")
    (warm,), (cold,) = (ask(ONE, [(setting, data)], LIMITS, warm=warm) for warm in (True, False))
    assert np.abs(warm.x[-1] - cold.x[-1]).max() > 1e-3
    np.testing.assert_array_equal(warm.x[0], cold.x[0])


@pytest.mark.parametrize("quiet", [True, False])
def test_times_are_reused_only_if_the_machine_was_quiet(quiet, tmp_path, monkeypatch):
    monkeypatch.setattr("moc_opt.study.timing.quiet", lambda row: quiet)
    (asked,) = ask(ONE, [(EXACT, TestSet.load("circle").thinned(16))], LIMITS)
    (first,), (again,) = (time(partial(ONE, kept=Kept(tmp_path / "jobs")), [asked], LIMITS) for _ in range(2))
    assert first.load["times_calls"] > first.solve.size == first.figures()["timed_solves"] > 0
    slow = first._replace(solve=first.solve + 9.0)
    found = totals([asked, asked], [first, slow])
    assert (found["solves"], found["solve_p50_us_worst_set"]) == (16, slow.figures()["solve_p50_us"])
    assert np.array_equal(again.solve, first.solve) is quiet


@pytest.mark.parametrize(
    "setting", solver_settings([n for n, why in available().items() if why is None]), ids=lambda e: e.label
)
def test_settings_have_only_known_options(setting, robot):
    assert len(setting.reason) > 10
    assert make_solver(setting.solver, robot, **setting.options).name == setting.solver


def test_settings_belong_to_known_solvers():
    assert set(SETTINGS) <= set(available())
    by_label = {e.label: effective(e) for e in solver_settings(["osqp", "qpsolvers:osqp", "exact"])}
    assert (by_label["osqp@recommended"]["cost_scale"], by_label["osqp@default"]["rows"]) == (100.0, 6)
    assert by_label["qpsolvers:osqp@recommended"]["eps_abs"] == 1e-8
    assert "eps_abs" not in by_label["qpsolvers:osqp@default"]
    found = {e.name: e.options for e in solver_settings(["osqp"], {"osqp": {"eps": 0.5}})}
    assert (found["recommended"], found["default"]["eps"]) == ({"eps": 0.5}, 1e-3)
