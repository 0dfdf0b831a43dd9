"""The paper's experiment: fair trials, verdicts that follow from the numbers, and a command that leaves its files."""

import io
import json
from collections import Counter

import numpy as np
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from benchmarks import paper
from benchmarks.common.output import default_config
from benchmarks.paper import Ablation, Config
from benchmarks.paper_experiment import page, verdict
from benchmarks.paper_experiment import procedure as paper_procedure
from benchmarks.paper_experiment import trials as paper_trials
from benchmarks.paper_experiment.procedure import ProcedureJob, ProcedureSettings
from benchmarks.paper_experiment.trials import (
    BASELINES,
    DAMPED,
    MATCHED,
    OWN,
    Job,
    Measurement,
    gain,
    run_job,
    seeds,
    swivel_jobs,
    trials,
    variant,
)
from benchmarks.paper_experiment.verdict import (
    CLAIMS,
    FAILS,
    GAINS_ONLY,
    HOLDS,
    UNDECIDED,
    Case,
    claim_verdict,
)
from moc_opt import scenario
from moc_opt.control import ControlSettings
from moc_opt.errors import MocOptError, PlantError, ScenarioError, UnknownNameError
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario, Setup
from moc_opt.study.statistics import Change, Interval, too_few
from moc_opt.tasks import make_path
from moc_opt.trace.trace import Trace
from moc_opt.vision.board import BOARD_TASKS, Board
from moc_opt.vision.camera import CameraSettings
from moc_opt.vision.hands_on import HandsOnSettings
from tests import first_screens

TINY = """
tasks = ["circle"]
trials = 2
solvers = ["exact", "rnn-printed"]
processes = 1
[groups.tuned]
about = "few and short trials"
control = { preset = "tuned" }
[ablation]
group = "tuned"
[ablation.cases.printed]
about = "as it is"
[ablation.cases.softer]
control = { K_N2 = 5.0 }
[swivel]
starts = 2
[procedure]
poses = 3
film = false
[procedure.camera]
rate_Hz = 10.0
[scenario]
duration_s = 0.7
judge = false
bound_samples = 0
"""
SHORT = Scenario(judge=False, bound_samples=0, duration_s=0.3, control={"preset": "tuned"})


@pytest.fixture(scope="module")
def trial():
    return trials(SHORT, ["circle"], [5])[0][1]


def measured(controller, trial, value, phase="whole", metric="tip_error_model_mean_mm", **more):
    metrics = {metric: value, "ticks": 100.0, **more}
    return Measurement("g", controller, "circle", trial, 0, phase, metrics)


# the trials


def test_trials_take_sizes_and_depth_from_the_virtual_tasks():
    drawn = trials(SHORT, list(BOARD_TASKS), seeds(0, 0, 6))
    assert [task for task, _ in drawn] == ["circle"] * 2 + ["sinusoid"] * 2 + ["spiral"] * 2
    assert len({scene.seed for _, scene in drawn}) == 6
    for task, scene in drawn:
        assert scene.task.sizes == dict(BOARD_TASKS[task].sizes)
        assert scene.trocar.depth_m == BOARD_TASKS[task].depth_m
        assert scene.start.swivel == "random"


def test_every_controller_meets_the_same_start_plant_and_noise(trial):
    setups = [Setup(variant(trial, name)) for name in (*BASELINES, "exact", "rnn-printed")]
    for other in setups[1:]:
        np.testing.assert_array_equal(other.q_start, setups[0].q_start)
        np.testing.assert_array_equal(other.trocar.point, setups[0].trocar.point)
        assert other.plant.mismatch.mass_scale == setups[0].plant.mismatch.mass_scale
        np.testing.assert_array_equal(other.plant.measure().q, setups[0].plant.measure().q)


@pytest.mark.parametrize("preset", ["paper", "tuned"])
def test_gains_and_compensation_are_equal_on_both_sides(trial, preset):
    case = trial.change(control={"preset": preset})
    tables = load_data("lwr4").gains
    moc = variant(case, "exact").control
    for name in BASELINES:
        dcac = variant(case, name).control
        assert dcac.law == "dcac"
        assert dcac.observer_gain_per_s == moc.observer_gain_per_s
        assert (dcac.feedforward, dcac.projector) == (moc.feedforward, moc.projector)
        ours, theirs = moc.resolve_gains(tables, 7)._asdict(), dcac.resolve_gains(tables, 7)._asdict()
        for key in ("K_X", "D_X", "K_N", "D_N"):
            assert theirs[key] == (tables["dcac"][key] if name == OWN else ours[key])
    assert variant(case, MATCHED).control.dcac_damping == 0.0
    assert min(variant(case, DAMPED).control.dcac_damping) > 1.0


def test_a_job_measures_every_controller_in_every_phase(trial):
    found = run_job(Job("g", "circle", trial, (*BASELINES, "exact"), keep_traces=True))
    assert found.broken == []
    seen = {(m.controller, m.phase) for m in found.measurements}
    for name in (*BASELINES, "exact"):
        assert {(name, "whole"), (name, "travelling")} <= seen
        assert found.samples[name, "circle"]["trocar_force_N"].ndim == 1
        assert name in found.traces
    by_key = {(m.controller, m.phase): m.metrics for m in found.measurements}
    assert by_key[MATCHED, "whole"]["mu_gain_percent"] == 0.0
    assert by_key["exact", "whole"]["mu_gain_percent"] != 0.0
    assert not any(name.endswith("_us") for m in found.measurements for name in m.metrics)
    shares = [m.metrics["share_of_ticks"] for m in found.measurements if m.controller == "exact" and m.phase != "whole"]
    assert sum(shares) == pytest.approx(1.0)


def test_settled_ticks_are_the_same_for_all_controllers_of_a_trial(trial, monkeypatch):
    """Two MOCs travel at different ticks: settled are those at which neither does, under DCAC too."""
    traces, asked = {}, []
    run = scenario.run

    def remembered(case):
        trace = run(case)
        traces[case.solver.name if case.control.law == "moc" else MATCHED] = trace
        return trace

    def flags(robot, t_s, q_rad, **_):
        name = next(name for name, trace in traces.items() if np.array_equal(trace.q_rad, q_rad))
        asked.append(name)
        window = slice(0, 40) if name == "exact" else slice(30, 90)
        found = np.zeros(len(t_s), dtype=bool)
        found[window] = True
        return found

    monkeypatch.setattr(scenario, "run", remembered)
    monkeypatch.setattr(paper_trials, "in_transient", flags)
    found = run_job(Job("g", "circle", trial, (MATCHED, "exact", "rnn")))
    assert asked == ["exact", "rnn"]
    settled = {m.controller: m.metrics for m in found.measurements if m.phase == "settled"}
    assert set(settled) == {MATCHED, "exact", "rnn"}
    for name, metrics in settled.items():
        assert metrics["ticks"] == len(traces[name]) - 90
        assert metrics["tip_error_mean_mm"] == pytest.approx(1e3 * traces[name].tip_error_m[90:].mean())
        registered = 1e3 * traces[name].rcm_error_registered_m[90:].mean()
        assert metrics["rcm_error_registered_mean_mm"] == pytest.approx(registered)


def test_a_run_that_breaks_off_is_a_result_with_its_reason(trial, monkeypatch):
    run = scenario.run

    def runs_away(case):
        if case.control.law == "moc":
            raise PlantError("the arm ran away")
        return run(case)

    monkeypatch.setattr(scenario, "run", runs_away)
    found = run_job(Job("g", "circle", trial, (MATCHED, "exact")))
    assert {m.controller for m in found.measurements} == {MATCHED}
    assert [entry["controller"] for entry in found.broken] == ["exact"]
    assert found.broken[0]["error"] == "PlantError: the arm ran away"
    assert found.broken[0]["ended"] == "failed"


def test_a_stopped_run_enters_no_mean_and_an_oscillating_one_is_counted(trial, monkeypatch):
    """The MOC is stopped for its RCM error; DCAC, which is whole, is said to shake."""
    run = scenario.run

    def ends(case):
        if case.control.law == "moc":
            return run(case.change(guard={"rcm_error_m": 1e-6, "rcm_warning_m": 1e-6}))
        trace = run(case)
        return Trace(trace.columns, {**trace.meta, "ended": "oscillated: joint_7 at 47 Hz, 0.51 rad/s"})

    monkeypatch.setattr(scenario, "run", ends)
    found = run_job(Job("g", "circle", trial, (MATCHED, "exact")))
    assert {m.controller for m in found.measurements} == {MATCHED}
    assert all(m.row("trials")["ended"].startswith("oscillated") for m in found.measurements)
    [broken] = found.broken
    assert broken["controller"] == "exact"
    assert broken["ended"].startswith("stopped: the RCM error")
    counts = verdict.group_summary(found.measurements, found.broken, "g", (MATCHED, "exact"))
    assert (counts[MATCHED]["broke_off"], counts[MATCHED]["oscillated"]) == (0, 1)
    assert (counts["exact"]["broke_off"], counts["exact"]["oscillated"]) == (1, 0)


# the verdict


def change(value, low, high, trials=15, of_ratios=None):
    ratio = Interval(value, low, high, trials)
    return Change(ratio, ratio if of_ratios is None else Interval(*of_ratios, trials))


UP, DOWN, NONE = change(20.0, 12.0, 30.0), change(-20.0, -30.0, -12.0), change(1.0, -3.0, 5.0)
SPLIT = change(-5.0, -8.0, -2.0, of_ratios=(3.0, -2.0, 9.0))
SHORT_OF = change(-20.0, -30.0, -12.0, trials=7)


@pytest.mark.parametrize(
    ("own", "matched", "wanted"),
    [
        (DOWN, DOWN, HOLDS), (DOWN, NONE, GAINS_ONLY), (DOWN, UP, GAINS_ONLY), (NONE, NONE, FAILS), (UP, UP, FAILS),
        (NONE, DOWN, HOLDS), (DOWN, SPLIT, UNDECIDED), (SPLIT, NONE, FAILS), (DOWN, SHORT_OF, too_few(7)),
        (None, None, too_few(0)),
    ],
)  # fmt: skip
def test_verdict_on_an_error(own, matched, wanted):
    assert claim_verdict(CLAIMS[1], own, matched) == wanted


def test_manipulability_must_rise_by_more_than_seven_percent_with_its_whole_interval():
    mu = CLAIMS[0]
    assert mu.confirmed(change(10.0, 7.1, 13.0))
    assert not mu.confirmed(change(10.0, 6.9, 13.0))
    assert not mu.confirmed(change(10.0, 7.1, 13.0, of_ratios=(10.0, 6.9, 13.0)))
    assert not mu.confirmed(change(10.0, 7.1, 13.0, trials=7))
    assert not mu.confirmed(change(10.0, float("nan"), float("nan"), trials=1))
    assert claim_verdict(mu, None, change(9.0, 7.1, 13.0, of_ratios=(8.0, 6.0, 13.0))) == UNDECIDED


def test_pairs_match_trials_and_leave_out_what_is_missing():
    found = [
        measured("exact", "a", 1.0), measured("exact", "b", 2.0), measured(MATCHED, "b", 20.0),
        measured(MATCHED, "a", 10.0), measured("exact", "c", 3.0),
        measured(MATCHED, "a", 99.0, "settled"),
    ]  # fmt: skip
    asked = ("g", "exact", MATCHED, "tip_error_model_mean_mm")
    assert verdict.pairs(found, *asked) == ([1.0, 2.0], [10.0, 20.0])
    assert verdict.effect(found, *asked).ratio.value == pytest.approx(-90.0)
    assert verdict.effect(found, *asked, "settled") is None


def test_a_trial_counts_by_its_ticks_in_the_phase():
    """One trial of 1000 settled ticks at -10 %, one of 10 at +100 %."""
    found = [
        measured("exact", "a", 0.9, "settled", ticks=1000.0), measured(MATCHED, "a", 1.0, "settled", ticks=1000.0),
        measured("exact", "b", 2.0, "settled", ticks=10.0), measured(MATCHED, "b", 1.0, "settled", ticks=10.0),
    ]  # fmt: skip
    found = verdict.effect(found, "g", "exact", MATCHED, "tip_error_model_mean_mm", "settled")
    assert found.ratio.value == pytest.approx(100 * (920 / 1010 - 1))
    assert found.undecided


def complete(controller, trial, scale, phase="whole", mu=0.3, gain=20.0, registered=None):
    metrics = {"tip_error_model_mean_mm": 0.05 * scale, "rcm_error_mean_mm": 0.4 * scale,
               "rcm_error_model_mean_mm": 0.12 * scale if registered is None else registered,
               "tip_error_registered_mean_mm": 0.07, "rcm_error_registered_mean_mm": 0.19, "tip_error_mean_mm": 0.6,
               "trocar_force_mean_N": 0.3 * scale, "mu_mean": mu, "mu_gain_percent": gain, "share_of_ticks": 0.5,
               "ticks": 100.0}  # fmt: skip
    return Measurement("g", controller, "circle", trial, 0, phase, metrics)


def reached(gains, settled=1.0, errors=None, registered=None):
    """Goal -> whether it is reached, by trials with these gains [%], settled changes and errors."""
    rng = np.random.default_rng(0)
    found = []
    for trial, percent in enumerate(gains):
        noise = 1.0 + 0.02 * rng.standard_normal()
        scale = 1.0 if errors is None else errors[trial]
        found += [
            complete("exact", str(trial), scale, mu=0.2 * (1 + percent / 100), gain=percent, registered=registered),
            complete(MATCHED, str(trial), 1.0, mu=0.2),
            complete("exact", str(trial), settled * noise, "settled"),
            complete(MATCHED, str(trial), 1.0, "settled"),
        ]
    rows = verdict.goals(found, "g", "exact")
    return {row["goal"]: row["reached"] for row in rows if row["limit"] is not None}


def test_goals_are_read_off_the_right_numbers():
    found = reached([17.0, 18.0, 25.0, 20.0] * 2)
    assert all(found.values())
    assert {"tip_mean", "tip_registered_mean", "rcm_mean", "rcm_registered_mean", "rcm_true_mean"} <= set(found)
    assert {f"settled_{part}{end}" for part in ("tip", "rcm") for end in verdict.FRAMES} <= set(found)
    assert reached([1.0, 2.0, 3.0, 4.0] * 2)["mu_gain"] is False
    assert reached([-1.0, *[40.0] * 7])["mu_worst"] is False
    worse = reached([20.0] * 8, settled=1.08)
    assert worse["settled_tip"] is worse["settled_rcm"] is False
    assert worse["tip_mean"]
    assert set(reached([20.0] * 7).values()) == {None}, "seven trials reach nothing and miss nothing"


def test_a_goal_about_a_mean_is_judged_by_the_end_of_its_interval():
    """Means of 20 % and 0.09 mm satisfy the numbers; what a few trials say about them does not."""
    assert reached([0.0, 2.0, 38.0, 40.0] * 2)["mu_gain"] is False
    assert reached([19.0, 20.0, 21.0, 20.0] * 2)["mu_gain"]
    wide = reached([20.0] * 8, errors=[0.2, 0.4, 3.0, 3.6] * 2)  # of 0.05 mm: 0.09 mm on average
    assert wide["tip_mean"] is False
    assert reached([20.0] * 8, errors=[1.78, 1.8, 1.82, 1.8] * 2)["tip_mean"]


def test_the_gain_is_of_the_means_not_the_mean_of_the_gains():
    """Gains of 100 % at a tenth of the mu and of 10 % elsewhere."""
    found = []
    for trial in range(8):
        low = 0.1 if trial % 2 else 1.0
        found += [
            complete("exact", str(trial), 1.0, mu=low * (2.0 if trial % 2 else 1.1), gain=100.0 if trial % 2 else 10.0),
            complete(MATCHED, str(trial), 1.0, mu=low),
        ]
    [goal] = [row for row in verdict.goals(found, "g", "exact") if row["goal"] == "mu_gain"]
    assert goal["value"] == pytest.approx(100 * (1.3 / 1.1 - 1))
    assert goal["value_of_ratios"] == pytest.approx(55.0)
    row = verdict.group_summary(found, [], "g", ["exact"])["exact"]
    assert row["mu_gain_percent"] == pytest.approx(goal["value"])
    assert row["mu_gain_percent_low"] == pytest.approx(goal["value_low"])


def test_rcm_goals_stand_on_the_trocar_that_the_controller_was_told():
    """A registered error twice DCAC's is hidden in the true one by the registration's own error."""
    found = []
    for trial in range(8):
        found += [
            complete("exact", str(trial), 1.0, "settled", registered=0.24),
            complete(MATCHED, str(trial), 1.0, "settled", registered=0.12),
        ]
    goals = {row["goal"]: row for row in verdict.goals(found, "g", "exact")}
    assert goals["settled_rcm"]["reached"] is False
    assert goals["settled_rcm"]["value"] == pytest.approx(100.0)
    assert reached([20.0] * 8, registered=0.3)["rcm_mean"] is False


def test_force_is_reported_and_not_counted():
    found = [complete(name, str(k), 1.0) for name in ("exact", MATCHED) for k in range(3)]
    rows = {row["claim"]: row for row in verdict.verdicts(found, "g", "exact")}
    assert {name for name, row in rows.items() if row["verdict"] == verdict.REPEATS} == {"force"}
    assert "matched_percent" in rows["force"]
    assert not [row for row in verdict.goals(found, "g", "exact") if "force" in row["goal"]]


def test_verdicts_name_every_claim_and_every_baseline():
    scales = {"exact": 1.0, OWN: 3.0, MATCHED: 1.0, DAMPED: 0.9}
    found = [complete(name, str(k), scale) for name, scale in scales.items() for k in range(8)]
    rows = {row["claim"]: row for row in verdict.verdicts(found, "g", "exact")}
    assert rows["mu"]["verdict"] == FAILS
    assert rows["tip"]["verdict"] == GAINS_ONLY
    assert rows["tip"]["own_percent"] == pytest.approx(-100 * 2 / 3)
    assert rows["tip"]["damped_percent"] == pytest.approx(100 / 0.9 - 100)


# the starting swivel


def test_a_start_at_the_largest_mu_gains_least():
    base = SHORT.change(duration_s=2.5)
    [(_, trial)] = trials(base, ["circle"], [5])
    rows = [{**row, **gain(run_job(job))} for row, job in swivel_jobs(trial, "circle", 2, "exact")]
    assert [row["fraction"] for row in rows] == sorted(row["fraction"] for row in rows)
    [top] = [row for row in rows if row["at_maximum"]]
    assert top["mu_start"] == max(row["mu_start"] for row in rows)
    assert abs(top["gain_percent"]) < 2.0
    summary = verdict.swivel_summary(rows)
    assert summary["gain_max_percent"] > summary["gain_at_maximum_percent"] + 3.0


def test_every_controller_has_its_boxes_even_without_outliers(trial):
    found = run_job(Job("g", "circle", trial, (MATCHED, "exact")))
    for column in found.samples[MATCHED, "circle"]:
        found.samples[MATCHED, "circle"][column] = np.linspace(0.2, 0.3, 50, dtype=np.float32)
    drawn = page.box_figures([found], "g", ["circle"])
    assert set(drawn) == {f"figure7-g-{short}" for short in ("mu", "tip", "rcm", "force")}
    for made in drawn.values():
        assert [box.name for box in made.data] == [BASELINES[MATCHED], "MOC, exact"]
        # plotly draws nothing of a controller whose first list of points is empty.
        assert all(len(points) for box in made.data for points in box.y)


# Table I with entries exchanged


@pytest.fixture(scope="module")
def shipped():
    return Config.load(default_config("paper"))


def test_the_cases_that_ship_exchange_what_they_say(shipped):
    """The first is the preset itself; each of the others differs from it in the settings that it names."""
    base = shipped.base(shipped.ablation.group)
    assert base.control == ControlSettings.paper()
    named = {}
    for name, case in shipped.ablation.cases.items():
        control = shipped.changed(case).control
        named[name] = {f for f in ControlSettings.model_fields if getattr(control, f) != getattr(base.control, f)}
        assert named[name] == {*case.control, *case.without}
    first, *others = shipped.ablation.cases
    assert named[first] == set()
    assert shipped.ablation.cases[first].controller == "exact"
    assert all(entries in [named[name] for name in others] for entries in ({"K_N2", "D_N2"}, {"D_X", "D_N"}))
    assert {"rcm_lambda"} in [named[name] for name in others]


def test_one_case_is_dcac_damped_with_the_papers_vector(shipped):
    """The damping of the self-motion alone, without a third level."""
    damped = [case for case in shipped.ablation.cases.values() if case.controller == DAMPED]
    found = [variant(shipped.changed(case), DAMPED).control.dcac_damping for case in damped]
    moc = load_data("lwr4").gains["moc"]
    assert moc["D_N2"] in found
    assert tuple(np.add(moc["K_N2"], moc["D_N2"])) in found


def test_every_case_runs_the_trials_of_its_group(shipped):
    shipped = shipped.model_copy(update={"trials": 2})
    drawn = {}
    for job in shipped.ablation_jobs():
        trial = job.trial
        drawn.setdefault(job.group, []).append((trial.name, trial.seed, trial.task, trial.start, trial.plant))
        assert job.controllers == (MATCHED, shipped.ablation.cases[job.group].controller)
    assert list(drawn) == list(shipped.ablation.cases)
    assert len({str(value) for value in drawn.values()}) == 1
    own = [(job.trial.name, job.trial.seed) for job in shipped.jobs() if job.group == "paper"]
    assert [entry[:2] for entry in drawn["printed"]] == own
    assert len(set(own)) == 2 * 3
    assert len(shipped.quick().ablation_jobs()) == 2 * 2


def test_a_setting_that_does_not_exist_is_refused(shipped):
    with pytest.raises(UnknownNameError, match="without 'rcm_lamda': did you mean 'rcm_lambda'"):
        shipped.changed(Case(without=["rcm_lamda"]))
    with pytest.raises(UnknownNameError, match="did you mean 'K_N2'"):
        shipped.changed(Case(control={"K_n2": 1.0}))
    unknown = shipped.model_copy(update={"ablation": Ablation(cases={"printed": Case(controller="exakt")})})
    with pytest.raises(UnknownNameError, match="unknown solver 'exakt': did you mean 'exact'"):
        unknown.check()


@pytest.fixture
def exchanged():
    """As printed -10 %; one exchange turns that into +20 %, one does nothing, one is too noisy to tell."""
    cases = {name: Case(about=name) for name in ("printed", "decides", "idle", "noisy")}
    rng, found = np.random.default_rng(0), []
    for k in range(20):
        size = rng.uniform(1.0, 2.0)
        for case, ratio in (("printed", 0.9), ("decides", 1.2), ("idle", 0.9), ("noisy", 0.2 if k % 2 else 2.0)):
            for name, value in (("exact", size * ratio * rng.uniform(0.99, 1.01)), (MATCHED, size)):
                metrics = {claim.metric: value for claim in CLAIMS}
                found.append(Measurement(case, name, "circle", str(k), 0, "whole", metrics))
    return cases, found


def test_what_decides_follows_from_the_numbers(exchanged):
    table = verdict.exchange_rows(*exchanged)
    tip = {row["case"]: row for row in table if row["claim"] == "tip"}
    assert tip["printed"]["effect_percent"] == pytest.approx(-10.0, abs=0.5)
    assert tip["decides"]["shift_percent"] == pytest.approx(30.0, abs=0.5)
    assert tip["decides"]["shift_percent_low"] > 29.0
    decides = {"printed": None, "decides": True, "idle": False, "noisy": False}
    assert {name: row.get("decides") for name, row in tip.items()} == decides
    assert [tip[name]["confirmed"] for name in ("printed", "decides", "idle")] == [True, False, True]
    said = " ".join(verdict.what_decides(table))
    assert "tip, rcm confirmed" in said
    assert "decides (mu, tip, rcm)" in said
    assert "idle" not in said
    other = [{**row, "controller": DAMPED if row["case"] == "decides" else "exact"} for row in table]
    assert "decides (" not in " ".join(verdict.what_decides(other))
    assert page.ablation_table(table).rows[0]["holds"] == "tip, rcm"


def test_trials_that_broke_off_on_one_side_are_left_out_of_the_shift(exchanged):
    cases, found = exchanged
    short = [m for m in found if (m.group, m.controller, m.trial) != ("decides", MATCHED, "3")]
    [row] = [row for row in verdict.exchange_rows(cases, short) if (row["case"], row["claim"]) == ("decides", "tip")]
    assert row["trials"] == 19
    assert row["decides"] is True
    few = verdict.exchange_rows(cases, [m for m in found if m.trial in set("012")])
    assert not any(row.get("decides") or row["confirmed"] for row in few)
    assert too_few(3) in verdict.what_decides(few)[0]


# the first screen


def claimed(group, solver, claim, said):
    value, low, high = {"mu": (16.3, 12.7, 20.1), "tip": (-8.6, -13.5, -3.6), "rcm": (-0.3, -10.6, 14.2)}[claim]
    return {"group": group, "controller": solver, "claim": claim, "verdict": said, "matched_percent": value,
            "matched_percent_low": low, "matched_percent_high": high}  # fmt: skip


def test_the_first_screen_opens_with_the_papers_own_network_and_fits_a_terminal():
    claims, said = ("mu", "tip", "rcm"), {"exact": FAILS, "rnn": HOLDS, "rnn-printed": UNDECIDED}
    rows = [claimed("tuned", "exact", claim, FAILS) for claim in claims]
    rows += [claimed("paper", solver, claim, words) for solver, words in said.items() for claim in claims]
    group = {name: {"trials": 45.0, "oscillated": 27 if name == "exact" else 0} for name in said}
    goals = [{"goal": "gain", "text": "gain", "reached": True, "limit": 15.0, "open": ""},
             {"goal": "rcm", "text": "RCM at most", "reached": False, "limit": 0.2, "open": "", "value": 0.31}]
    first = page.answer({"verdict": rows, "paper": group, "goals": goals}, ["tuned", "paper"], {})
    network, reference = first.sentences[0].split("). ")
    assert all(words in network for words in ("`rnn`", "3 of 3 hold", "mu 16.3 [12.7, 20.1]", "45 trials"))
    assert all(words in reference for words in ("`exact`", "0 of 3 hold", "27 of them shake"))
    assert first.sentences[1].endswith("1 of 2 goals are reached; missed: RCM at most 0.2 (found 0.31).")
    assert [line["name"] for line in first.table.rows] == [
        "paper, rnn", "paper, exact; 27 shook", "paper, rnn-printed", "tuned, exact"
    ]  # fmt: skip
    assert [line["tip"].symbol for line in first.table.rows] == ["✔", "✘", "–", "✘"]
    assert {shape.x0 for shape in first.pictures[0].figure.layout.shapes} == {0.0, 7.0}
    screen = Console(file=io.StringIO(), width=80, color_system=None)
    for part in first.screens(80):
        screen.print(part, markup=False)
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text


# the procedure


@pytest.fixture(scope="module")
def procedure():
    return ProcedureSettings(
        camera=CameraSettings(rate_Hz=10.0, width_px=400, height_px=300),
        board=Board(lost_s=((1.0, 2.0),)),
    )


def test_the_procedure_leads_from_the_hand_to_the_task(procedure, tmp_path):
    base = SHORT.change(duration_s=None, seed=1, task={"v_max_m_per_s": 0.1})
    row = paper_procedure.perform(ProcedureJob(procedure, base, "circle", tmp_path / "film.webm"))
    assert (row["ended"], row["share_of_run"]) == ("completed", 1.0)
    assert 0.0 < row["registration_error_mm"] < 5.0
    assert row["hand_force_max_N"] <= procedure.hands_on.hand.force_max_N + 1e-9
    assert row["board_position_mm"] < 2.0
    assert 0.9 < row["waited_s"] < 2.5  # lost for a second, and brakes before and after
    assert row["tip_error_mean_mm"] < 1.5  # absolute: the arm is half a millimetre off its kinematics
    # What is off the task is where the board was taken to be, and no more than the tip's error beyond that.
    assert row["path_deviation_max_mm"] < row["task_error_max_mm"] + 1.0
    assert row["pictures"] > 10
    assert (tmp_path / "film.webm").stat().st_size > 1000


def test_the_procedure_is_guarded_as_every_loop_is(procedure):
    base = SHORT.change(duration_s=None, seed=1, guard={"rcm_error_m": 2e-4, "rcm_warning_m": 1e-4})
    row = paper_procedure.perform(ProcedureJob(procedure, base, "circle"))
    assert row["ended"].startswith("stopped: the RCM error has been above 0.2 mm")
    assert row["share_of_run"] < 1.0


@pytest.mark.parametrize(
    ("table", "value", "message"),
    [
        ("board", Board(hidden_fraction=1.0), "board: never seen"),
        ("hands_on", HandsOnSettings(time_limit_s=0.2), "did not reach the incision"),
    ],
)
def test_a_procedure_that_cannot_go_on_says_why(procedure, table, value, message):
    with pytest.raises(MocOptError, match=message):
        paper_procedure.perform(ProcedureJob(procedure.model_copy(update={table: value}), SHORT, "circle"))


def test_distance_from_a_path_does_not_ask_when():
    path = make_path("circle", (0.0, 0.0, 0.0), normal=(0, 0, 1), heading=(1, 0, 0), radius=0.02)
    on = path.at(np.linspace(0.0, path.length, 57))[0]
    assert paper_procedure.from_path(on, path).max() < 2e-5
    above = on + np.array([0.0, 0.0, 0.001])
    np.testing.assert_allclose(paper_procedure.from_path(above, path), 0.001, atol=2e-5)


# the configuration and the command


def test_the_configuration_that_ships_is_the_papers_experiment(shipped):
    config = shipped
    jobs = config.jobs()
    assert len(jobs) == 45 * len(config.groups)
    of_paper = [job for job in jobs if job.group == "paper"]
    assert Counter(job.task for job in of_paper) == {"circle": 15, "sinusoid": 15, "spiral": 15}
    assert {"exact", "rnn", "rnn-printed", *BASELINES} == set(of_paper[0].controllers)
    assert of_paper[0].trial.control.regularization == 0.0
    tuned = [job.trial for job in jobs if job.group == "tuned"]
    assert [t.seed for t in tuned] == [job.trial.seed for job in of_paper]


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        (('"circle"', '"circel"'), UnknownNameError, "did you mean 'circle'"),
        (('"rnn-printed"', '"rnn-print"'), UnknownNameError, "did you mean 'rnn-printed'"),
        (('"tuned" }', '"tunde" }'), UnknownNameError, "did you mean 'tuned'"),
        (("groups.tuned", "groups.other"), UnknownNameError, "unknown group 'tuned'"),
        (("trials = 2", "trials = 0"), ScenarioError, "trials = 0"),
        (("trials = 2", "trails = 2"), UnknownNameError, "did you mean 'trials'"),
        (("[swivel]", "[swivel"), ScenarioError, r"bad\.toml"),
    ],
)
def test_wrong_configurations_are_refused_before_anything_moves(tmp_path, wrong, error, message):
    file = tmp_path / "bad.toml"
    assert wrong[0] in TINY
    file.write_text(TINY.replace(*wrong))
    with pytest.raises(error, match=message):
        Config.load(file)


def test_the_command_leaves_its_files_and_repeats_itself(tmp_path, capsys):
    file = tmp_path / "tiny.toml"
    file.write_text(TINY)
    assert paper.main([str(file), "--out", str(tmp_path / "a")]) == 0
    assert "Do the paper's claims hold?" in capsys.readouterr().out
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert set(summary["tuned"]) == {*BASELINES, "exact", "rnn-printed"}
    assert summary["tuned"]["exact"]["trials"] == 2
    assert {row["claim"] for row in summary["verdict"]} == {claim.name for claim in verdict.EVERY}
    assert summary["swivel"]["starts"] == 3
    rows = pq.read_table(tmp_path / "a" / "rows.parquet").to_pylist()
    assert {row["part"] for row in rows} == {"trials", "ablation", "swivel", "procedure"}
    assert {row["case"] for row in summary["ablation"]} == {"printed", "softer"}
    assert summary["procedure"]["circle"]["registered"] is True
    assert summary["board_pictures"]["seen"] == 1.0
    environment = json.loads((tmp_path / "a" / "environment.json").read_text())
    assert environment["config"]["groups"]["tuned"]["about"] == "few and short trials"
    assert "shared" in environment["timing"]
    assert [row["name"] for row in summary["courses"]] == [*BASELINES.values(), "MOC, exact", "MOC, rnn-printed"]
    html = (tmp_path / "a" / "report.html").read_text()
    first_screens.check(html, pictures=1)  # of one trial there is no interval to draw
    assert 'id="map-circle"' in html
    assert 'href="replay.html"' in html
    assert "Which entry of Table I decides" in html
    assert (tmp_path / "a" / "replay.html").stat().st_size > 10_000

    assert paper.main([str(file), "--out", str(tmp_path / "b"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == summary


def test_wrong_input_ends_the_command_with_a_message(tmp_path, capsys):
    assert paper.main([str(tmp_path / "none.toml"), "--out", str(tmp_path)]) == 2
    assert "none.toml" in capsys.readouterr().err
