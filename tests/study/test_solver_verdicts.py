"""The verdict on each solver follows from the rules in docs/solvers.md."""

import io
import re
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from moc_opt.study import solver_verdicts
from moc_opt.study.results import Results, change_name
from moc_opt.study.show import Report
from moc_opt.study.solver_parts import figures
from moc_opt.study.solver_verdicts import AVOID, NEAR, SOUND, TAKE, assess, first_table, sentences
from moc_opt.study.statistics import spread

NOISE = np.random.default_rng(3).lognormal(0.0, 0.5, 60)
MEANS = {
    "mu_mean": 0.3, "tip_error_model_mean_mm": 0.2, "rcm_error_model_mean_mm": 0.4, "torque_rate_rms_Nm_per_s": 600.0,
    "tip_error_registered_mean_mm": 0.3, "rcm_error_registered_mean_mm": 0.5,
}  # fmt: skip
ENDED = {"broke off": "stopped: the tip", "oscillated": "oscillated: joint_3"}


def runs(controller: str, trials: int = 15, unlike: float = 0.0, first_ends: str = "completed", **scale: float) -> Any:
    """Return the rows of trials. `scale` multiplies metrics. `unlike` is the sigma of the controller's noise."""
    own = np.random.default_rng(5).lognormal(0.0, unlike, trials) if unlike else np.ones(trials)
    found = []
    for k in range(trials):
        ended = first_ends if k == 0 else "completed"
        values = {name: value * scale.get(name, 1.0) * NOISE[k] * own[k] for name, value in MEANS.items()}
        found.append({"trial": f"circle/{k}", "controller": controller, "ended": ended, "error": None,
                      "whole": not ended.startswith("stopped"), "silently_wrong": 0, **values})  # fmt: skip
    return found


def certified(right: int = 1000, p50: float = 5.0, p99: float = 9.0, **more: Any) -> dict[str, Any]:
    found = {
        "solves": 1000, "right": right, "claimed_solved": right, "silently_wrong": 0, "hung": 0, "crashed": 0,
        "verified_solved": right, "optima_asked": 1000, "infeasible_asked": 0, "refused_inconsistent": 0,
    }  # fmt: skip
    return {**found, "solve_p50_us_worst_set": p50, "solve_p99_us_worst_set": p99, "relative_max": 1e-9, **more}


def study(sets: dict[str, Any], rows: list[Any] = ()) -> tuple[dict[str, Any], Results]:  # type: ignore[assignment]
    results = Results(rows)
    summary: dict[str, Any] = {"testsets": {f"{name}@recommended": found for name, found in sets.items()}}
    if rows:
        summary["closed_loop"] = {name: figures(results, name) for name in results.names()}
    return summary, results


def assessed(sets: dict[str, Any], rows: list[Any] = ()) -> dict[str, Any]:  # type: ignore[assignment]
    return {row["solver"]: row for row in assess(*study(sets, rows))}


@pytest.mark.parametrize(("asked", "changes", "verdict", "damage"), [
    (certified(), {}, SOUND, "none"), (certified(990), {}, SOUND, "none"),
    (certified(989), {}, solver_verdicts.GAPS, "none"), (certified(silently_wrong=1), {}, AVOID, "none"),
    (certified(hung=1), {}, AVOID, "none"), (certified(0), {}, NEAR, "none"),
    (certified(), {"mu_mean": 0.995}, SOUND, "none"), (certified(), {"mu_mean": 0.97}, NEAR, "-3% mu"),
    (certified(), {"mu_mean": 0.90}, AVOID, "-10% mu"),
    (certified(), {"rcm_error_model_mean_mm": 2.0}, AVOID, "+100% RCM"),
    (certified(), {"tip_error_registered_mean_mm": 1.1}, NEAR, "+10% registered tip"),
    (certified(), {"torque_rate_rms_Nm_per_s": 1.15}, NEAR, "+15% chatter"),
    (certified(), {"first_ends": ENDED["broke off"]}, AVOID, "1 broke off"),
    (certified(), {"first_ends": ENDED["oscillated"]}, AVOID, "1 oscillated"), (None, {}, solver_verdicts.OPEN, "none"),
])  # fmt: skip
def test_each_rule_gives_its_verdict(asked, changes, verdict, damage):
    sets = {"best": certified(p99=1.0), **({} if asked is None else {"asked": asked})}
    found = assessed(sets, [*runs("dcac"), *runs("best"), *runs("asked", **changes)])
    assert (found["asked"]["verdict"], found["asked"]["damage"]) == (verdict, damage)
    assert found["best"]["verdict"] is TAKE


@pytest.mark.parametrize("ended", ENDED.values())
def test_bad_ending_does_not_count_if_no_other_solver_ran_the_trial(ended):
    """The trial might end badly with every solver."""
    mine = runs("asked", 60)
    mine[40] |= {"ended": ended, "whole": not ended.startswith("stopped")}
    common = {row["trial"] for row in mine[:15]}
    results = Results([*runs("best"), *mine])
    summary = study({"best": certified(p99=1.0), "asked": certified()})[0]
    summary["closed_loop"] = {name: figures(results, name, common=common) for name in ("best", "asked")}
    found = {row["solver"]: row for row in assess(summary, results)}["asked"]
    assert (found["verdict"], found["damage"]) == (SOUND, "none")
    assert found["closed"]["oscillated"] + found["closed"]["trials"] - found["closed"]["whole"] == 1


def test_solver_with_wrong_answers_in_closed_loop_is_to_be_avoided():
    lying = [{**row, "silently_wrong": 1} for row in runs("asked")]
    assert assessed({"best": certified(), "asked": certified()}, [*runs("best"), *lying])["asked"]["verdict"] is AVOID
    row = assessed({"best": certified(), "nlp-sqp": certified(50, silently_wrong=900)}, runs("best"))["nlp-sqp"]
    assert row["verdict"] is solver_verdicts.OTHER
    assert "nonlinear" in row["silently_wrong"].reason


def test_one_solver_is_recommended():
    found = assessed({
        "best": certified(p99=1.0), "slow": certified(p99=50.0), "liar": certified(p99=0.1, silently_wrong=1),
        "half": certified(500), "most": certified(900, p99=90.0),
    })  # fmt: skip
    assert list(found) == ["best", "slow", "most", "half", "liar"]
    assert [row["verdict"] for row in found.values()].count(TAKE) == 1
    assert assess({}, Results()) == []
    rows = assess(*study({name: certified() for name in ("daqp", "qpsolvers:daqp", "qpsolvers:scs")}))
    assert [row["solver"] for row in rows] == ["daqp", "qpsolvers:scs"], "qpsolvers:daqp is the same library"
    assert "not run" in rows[0]["damage"].reason


@pytest.mark.parametrize(("cost", "unlike", "trials", "verdict", "damage"), [
    (1.07, 0.0, 15, NEAR, "+7% tip"),
    (1.07, 0.3, 15, SOUND, "undecided: "),  # mean loss as in the first case, but a wider interval
    (1.01, 0.02, 15, SOUND, "none"), (2.5, 0.3, 15, AVOID, "% tip"),
    (1.6, 0.0, 7, SOUND, "too few trials to decide (7 of at least 8)"), (1.6, 0.0, 8, AVOID, "+60% tip"),
])  # fmt: skip
def test_uncertain_loss_does_not_count(cost, unlike, trials, verdict, damage):
    rows = [*runs("best", 60), *runs("asked", trials, unlike, tip_error_model_mean_mm=cost)]
    if unlike:
        for row, mine in zip(rows, rows[60:], strict=False):
            mine |= {name: row[name] for name in MEANS if name != "tip_error_model_mean_mm"}
    row = assessed({"best": certified(p99=1.0), "asked": certified()}, rows)["asked"]
    assert row["verdict"] is verdict
    assert damage in getattr(row["damage"], "reason", row["damage"])


def test_busy_machine_gives_a_remark():
    busy = {"times_calls": 1000, "times_switches": 9, "times_cpu_s": 1.0, "times_wall_s": 1.0}
    rivals = (({}, False), (busy, True), ({**busy, "times_switches": 2}, False), ({**busy, "p50": 59.0}, False))
    for more, said in rivals:  # the median of the last rival is too large for noise to exchange the order
        summary, results = study({"fast": certified(), "slow": certified(p99=60.0, **more)})
        text = sentences(summary, assess(summary, results))[0]
        assert text.startswith("Use `fast`")
        assert ("other programs used the machine" in text) is said


def test_first_screen_fits_a_terminal():
    sets = {
        "exact": certified(1799, 1.2, 1.5, solves=2048, optima_asked=1621, verified_solved=1620, infeasible_asked=179,
                           infeasible_right=179, refused_inconsistent=248, inconsistent_asked=621),
        "clarabel": certified(2047, 48.5, 60.0, solves=2048), "nlp-ipopt": certified(268, silently_wrong=1776),
        "qpsolvers:highs": certified(1767, 900.0, 999.0, solves=2048, silently_wrong=1),
        "qpsolvers:quadprog": certified(0, 1234.6, 9999.9),
    }  # fmt: skip
    rows = [*runs("dcac", 60)]
    for name in sets:
        rows += runs(name, 60 if name == "exact" else 15, 0.1, mu_mean=1.12, tip_error_registered_mean_mm=2.0)
    summary, results = study(sets, rows)
    plain = {"osqp": 1301, "qpsolvers:scs": 432, "piqp": 0, "rnn": 7}
    summary["testsets"] |= {f"{name}@default": certified(silently_wrong=wrong) for name, wrong in plain.items()}
    summary["settings"] = {"exact@recommended": {"reason": "nothing to set"}}
    for row in summary["closed_loop"].values():
        row |= {"tick_p50_us": 37.0, "tick_p99_us": 105.0, "tick_p99_9_us": 2100.0}
    rows = assess(summary, results)
    take, sound, avoid = sentences(summary, rows)
    assert take.startswith("Use `exact` (nothing to set). ")
    for counted in ("1620 of 1621 certified optima", "179 of 179 infeasible", "refused 248 more", "1.2 us, p99 1.5",
                    "Also sound: `clarabel` (48 us)"):  # fmt: skip
        assert counted in take
    assert "`exact` ran 60 independent trials" in sound
    model, registered = rows[0]["tip_change"].split("/")
    common = "In the first 15 trials, which the other solvers ran too, the registered tip error changes by "
    assert f"{common}{registered} %, and the tip error computed with the robot's kinematic model by {model} %." in sound
    for name in ("mu_mean", "tip_error_registered_mean_mm", "rcm_error_registered_mean_mm"):
        assert spread(summary["closed_loop"]["exact"], change_name(name), 2, "+", " %") in sound
    assert "`qpsolvers:highs` (1 silently wrong)" in avoid
    listed = "`osqp` 1301, `qpsolvers:scs` 432, `piqp` 0"
    assert f"2 of 3 libraries claimed success for wrong answers (counts: {listed})." in avoid
    assert "nlp" not in avoid
    assert "rnn" not in avoid, "the network is not the solver of a library"

    shown = Report("t", [take, sound, avoid], first_table(summary, rows))
    screen = Console(file=io.StringIO(), width=80, color_system=None, highlight=False)
    for part in shown.screens():
        screen.print(part, markup=False)
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "99.95" in text, "2047 of 2048 is not 100 %"
    assert "99.94" in text
    few = Results(row for row in results if row["trial"] in results.values("mu_mean", "clarabel"))
    for row in rows[:2]:
        own, registered = (few.change(f"tip_error_{by}_mean_mm", row["solver"]).ratio for by in ("model", "registered"))
        assert row["tip_change"].replace("?", "") == f"{own.value:+.0f}/{registered.value:+.0f}", "the first 15 trials"
        assert row["tip_change"] in re.sub(r"\s", "", text)
