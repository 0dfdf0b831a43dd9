"""The study of the paper's claims."""

from collections import Counter

import numpy as np
import pytest

from benchmarks import paper, procedure
from benchmarks.paper import CLAIMS, FAILS, GAINS_ONLY, HOLDS, UNDECIDED, Case, Config
from benchmarks.procedure import ProcedureSettings
from moc_opt.control import ControlSettings
from moc_opt.errors import MocOptError
from moc_opt.scenario import Scenario
from moc_opt.study.command import CONFIGS
from moc_opt.study.results import Results
from moc_opt.study.statistics import too_few
from moc_opt.study.trials import BASELINES, OWN
from moc_opt.vision.camera import CameraSettings
from moc_opt.vision.hands_on import HandsOnSettings
from tests.benchmarks.test_goals import change

TINY = """
tasks = ["circle"]
trials = 1
solvers = ["exact", "rnn-printed"]
groups.tuned = { about = "few and short trials", control = { preset = "tuned" } }
ablation.group = "tuned"
ablation.cases = { printed = { about = "as it is" }, softer = { control = { K_N2 = 5.0 } } }
swivel = { starts = 2 }
procedure.camera = { rate_Hz = 10.0, width_px = 400, height_px = 300 }
procedure.board = { lost_s = [[1.0, 2.0]] }
scenario = { task = { v_max_m_per_s = 0.1 }, duration_s = 0.4, judge = false, bound_samples = 0 }
"""
SMALL = CameraSettings(rate_Hz=10.0, width_px=400, height_px=300)
QUICK = Scenario(judge=False, bound_samples=0, seed=1, control={"preset": "tuned"}, task={"v_max_m_per_s": 0.1})
SHIPPED = Config.load(CONFIGS / "paper.toml")
BETTER, WORSE, OPEN = (change(ends, ends) for ends in ((-9, -3), (3, 9), (-3, 9)))
ODD, FEW = change((-9, -3), (-2, 5)), change((-9, -3), (-9, -3), 7)


@pytest.mark.parametrize(("own", "matched", "wanted"), [
    (BETTER, BETTER, HOLDS), (WORSE, BETTER, HOLDS), (BETTER, OPEN, GAINS_ONLY), (BETTER, WORSE, GAINS_ONLY),
    (OPEN, OPEN, FAILS), (WORSE, WORSE, FAILS), (None, WORSE, FAILS), (BETTER, ODD, UNDECIDED),
    (BETTER, FEW, too_few(7)), (BETTER, None, too_few(0)),
])  # fmt: skip
def test_verdict_uses_dcac_with_its_own_gains_and_dcac_with_matched_gains(own, matched, wanted):
    assert CLAIMS[1].verdict(own, matched) == wanted
    found = [CLAIMS[0].verdict(None, change(ends, ends)) for ends in ((7.5, 20), (6.5, 20), (-20, -8))]
    assert found == [HOLDS, FAILS, FAILS], "the whole interval of mu must lie above 7 %"


def row(group, controller, k, mu=1.0, tip=1.0, **more):
    about = {"part": "trials", "group": group, "controller": controller, "trial": f"t{k}", "whole": True}
    errors = dict.fromkeys([*paper.ERRORS, *(f"settled_{name}" for name in paper.ERRORS)], 1.0)
    own = {"mu_mean": mu, "tip_error_model_mean_mm": tip, "settled_ticks": 100}
    return {**about, "ended": "completed", **errors, **own, **more}


def test_claims_compare_runs_of_one_group():
    ten = range(10)
    rows = [row("tuned", name, k, tip=2.0 if name == OWN else 1.0) for name in BASELINES for k in ten]
    rows += [row("tuned", "exact", k, mu=1.2 + 0.001 * k, tip=1.1, settled_rcm_error_mean_mm=1.2) for k in ten]
    rows += [row("other", name, k, mu=5.0) for name in ("dcac", "exact") for k in ten]
    results = Results(rows)
    found = {entry["claim"]: entry for entry in paper.claims(results.where(group="tuned"), "tuned", "exact")}
    assert (found["mu_mean"]["verdict"], found["tip_error_model_mean_mm"]["verdict"]) == (HOLDS, GAINS_ONLY)
    assert found["mu_mean"]["matched_percent"] == pytest.approx(20.45)
    goals = paper.goals(results, "tuned", "exact")
    assert goals["mu_worst"]["value"] == pytest.approx(20.0)
    reached = {key: goal["reached"] for key, goal in goals.items()}
    assert (reached["mu_gain"], reached["mu_worst"], reached["settled_tip_error_model_mean_mm"]) == ("yes",) * 3
    assert (reached["settled_rcm_error_mean_mm"], reached["tip_error_model_mean_mm"]) == ("no", "no")
    few = paper.goals(Results(entry for entry in rows if entry["trial"] < "t5"), "tuned", "exact")
    assert {few[key]["reached"] for key in ("mu_gain", "settled_rcm_error_mean_mm", "mu_worst")} == {"open"}


def test_ablation_marks_cases_that_reverse_a_claim():
    cases = {name: Case(about=name) for name in ("printed", "turns", "same", "noisy")}
    rng, rows = np.random.default_rng(3), []
    for name, tip, spread in (("printed", 0.9, 0.0), ("turns", 1.2, 0.0), ("same", 0.9, 0.0), ("noisy", 1.01, 0.5)):
        for k in range(15):
            value = tip * (1.0 + 0.01 * rng.normal() + spread * rng.normal())
            rows += [row(name, "dcac", k), row(name, "exact", k, tip=value)]
    lost = next(entry for entry in rows if entry["group"] == "turns" and entry["controller"] == "exact")
    lost |= {"whole": False, "tip_error_model_mean_mm": 99.0}
    found = {(entry["case"], entry["claim"]): entry for entry in paper.ablation(Results(rows), cases)}
    assert {name: found[name, "tip, model"].get("decides") for name in cases} == {
        "printed": None, "turns": True, "same": False, "noisy": False,
    }  # fmt: skip
    assert found["turns", "tip, model"]["shift_percent"] == pytest.approx(30.0, abs=2.0)


def test_shipped_configuration_is_the_papers_experiment():
    cases = {group: SHIPPED.cases(SHIPPED.base(group)) for group in SHIPPED.groups}
    tasks = Counter(case.name.partition("/")[0] for case in cases["paper"])
    assert tasks == {"circle": 15, "sinusoid": 15, "spiral": 15}
    assert SHIPPED.base(SHIPPED.ablation.group).control == ControlSettings.preset("paper")
    one_number = SHIPPED.cases(SHIPPED.changed(SHIPPED.ablation.cases["one-number"]))
    for mine in (*cases.values(), one_number):
        assert [case.seed for case in mine] == [case.seed for case in cases["paper"]]


def test_stopped_procedure_reports_the_reason():
    with pytest.raises(MocOptError, match="did not reach the incision"):
        procedure.perform(ProcedureSettings(camera=SMALL, hands_on=HandsOnSettings(time_limit_s=0.2)), QUICK, "circle")
    base = QUICK.change(guard={"rcm_error_m": 2e-4, "rcm_warning_m": 1e-4})
    row = procedure.perform(ProcedureSettings(camera=SMALL), base, "circle")
    assert row["ended"].startswith("stopped: the RCM error has been above 0.2 mm")
    assert row["share_of_run"] < 1.0


def test_command_runs_every_part_of_the_study(tiny):
    left = tiny(paper, TINY)
    summary = left.summary
    found = summary["groups"]["tuned"]
    assert set(found) == {*BASELINES, "exact", "rnn-printed"}
    assert (found["exact"]["whole"], found["exact"]["compared"]) == (1, 1)
    assert {entry["claim"] for entry in summary["claims"]} == {claim.metric for claim in CLAIMS}
    assert {entry["case"] for entry in summary["ablation"]} == {"printed", "softer"}
    assert summary["swivel"]["starts"] == 3
    assert summary["swivel"]["gain_at_maximum_percent"] <= summary["swivel"]["gain_max_percent"]
    assert {row["part"] for row in left.rows} == {"trials", "ablation", "swivel", "procedure"}
    assert not [name for name in left.rows[0] if name.endswith("_us")], "no times, since several runs share the machine"
    row = summary["procedure"]["circle"]
    assert (row["ended"], row["share_of_run"], row["registered"]) == ("completed", 1.0, True)
    assert 0.0 < row["registration_error_mm"] < 5.0
    assert row["board_position_mm"] < 2.0
    assert 0.9 < row["waited_s"] < 2.5  # 1 s without the board, plus restarting
    assert row["tip_error_mean_mm"] < 1.5  # the arm deviates from its model by half a millimetre
    assert row["path_deviation_max_mm"] < row["task_error_max_mm"] + 1.0
    assert row["pictures"] > 10
    assert (left.out / "film.webm").stat().st_size > 1000
