"""Table I with entries exchanged: what is exchanged is exchanged on both sides, and the numbers say what decides."""

import numpy as np
import pytest

from benchmarks.common.output import default_config
from benchmarks.paper_experiment import ablation
from benchmarks.paper_experiment.ablation import ALL, Ablation, Case
from benchmarks.paper_experiment.config import Config
from benchmarks.paper_experiment.tables import ablation_table
from benchmarks.paper_experiment.trials import DAMPED, MATCHED, Measurement, variant
from benchmarks.paper_experiment.verdict import CLAIMS
from moc_opt import scenario
from moc_opt.control import ControlSettings
from moc_opt.errors import PlantError, UnknownNameError
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario
from moc_opt.trace.metrics import summarize

SHORT = Scenario(judge=False, duration_s=0.3, control={"preset": "paper"})


@pytest.fixture(scope="module")
def shipped():
    return Config.load(default_config("paper"))


def test_the_cases_that_ship_exchange_what_they_say(shipped):
    """The first is the preset itself; each of the others differs from it in the settings that it names."""
    base = shipped.base(shipped.ablation.group)
    assert base.control == ControlSettings.paper()
    named = {}
    for name, case in shipped.ablation.cases.items():
        control = ablation.changed(base, case).control
        named[name] = {f for f in ControlSettings.model_fields if getattr(control, f) != getattr(base.control, f)}
        assert named[name] == {*case.control, *case.without}
    first, *others = shipped.ablation.cases
    assert named[first] == set()
    assert shipped.ablation.cases[first].controller == "exact"
    assert {"K_N2", "D_N2"} in [named[name] for name in others]
    assert {"D_X", "D_N"} in [named[name] for name in others]
    assert {"rcm_lambda"} in [named[name] for name in others]


def test_one_case_is_dcac_damped_with_the_papers_vector(shipped):
    """The damping of the self-motion alone, without a third level."""
    base = shipped.base(shipped.ablation.group)
    damped = [case for case in shipped.ablation.cases.values() if case.controller == DAMPED]
    found = [variant(ablation.changed(base, case), DAMPED).control.dcac_damping for case in damped]
    moc = load_data("lwr4").gains["moc"]
    assert moc["D_N2"] in found
    assert tuple(np.add(moc["K_N2"], moc["D_N2"])) in found


def test_every_case_runs_the_same_trials_and_every_draw_others(shipped):
    shipped = shipped.model_copy(update={"trials": 2, "ablation": shipped.ablation.model_copy(update={"draws": 2})})
    jobs = shipped.ablation_jobs()
    names = {}
    for job in jobs:
        assert list(job.cases) == list(shipped.ablation.cases)
        for case, (trial, _) in job.cases.items():
            names.setdefault(case, []).append((trial.name, trial.seed, trial.task, trial.start, trial.plant))
    assert len({str(value) for value in names.values()}) == 1
    seeds = [seed for _, seed, *_ in names["printed"]]
    assert len(set(seeds)) == len(seeds) == 2 * 6
    assert len({name for name, *_ in names["printed"]}) == len(seeds)
    of_group = [job.trial.seed for job in shipped.jobs() if job.group == "paper"]
    assert seeds[:6] == of_group
    assert len(shipped.quick().ablation_jobs()) == 2


def test_a_setting_that_does_not_exist_is_refused(shipped):
    with pytest.raises(UnknownNameError, match="without 'rcm_lamda': did you mean 'rcm_lambda'"):
        ablation.changed(SHORT, Case(without=["rcm_lamda"]))
    with pytest.raises(UnknownNameError, match="did you mean 'K_N2'"):
        ablation.changed(SHORT, Case(control={"K_n2": 1.0}))
    unknown = shipped.model_copy(update={"ablation": Ablation(cases={"printed": Case(controller="exakt")})})
    with pytest.raises(UnknownNameError, match="unknown controller 'exakt': did you mean 'exact'"):
        unknown.check()


def test_a_job_measures_both_sides(monkeypatch):
    cases = {"printed": Case(), "soft": Case(control={"K_N2": 5.0}), "stiff": Case(control={"D_X": 90.0})}
    [job] = ablation.jobs(Ablation(draws=1, cases=cases), SHORT, ["circle"], 1, 0, 0)
    run, asked = scenario.run, []

    def counted(case):
        asked.append(case.control.law)
        return run(case)

    monkeypatch.setattr(scenario, "run", counted)
    found, broken = ablation.measure(job)
    assert broken == []
    assert [(m.group, m.controller) for m in found] == [(c, name) for c in cases for name in (MATCHED, "exact")]
    assert (asked.count("dcac"), asked.count("moc")) == (2, 3)  # DCAC has no third level
    whole = run(variant(job.cases["soft"][0], MATCHED))
    by_case = {(m.group, m.controller): m.metrics for m in found}
    assert by_case["soft", MATCHED]["tip_error_model_mean_mm"] == summarize(whole)["tip_error_model_mean_mm"]
    assert by_case["printed", MATCHED] == by_case["soft", MATCHED] != by_case["stiff", MATCHED]
    assert by_case["printed", "exact"] != by_case["soft", "exact"]
    assert set(by_case["soft", "exact"]) == {claim.metric for claim in CLAIMS}

    def runs_away(case):
        raise PlantError("the arm ran away")

    monkeypatch.setattr(scenario, "run", runs_away)
    found, broken = ablation.measure(job)
    assert found == []
    assert [entry["error"] for entry in broken] == ["PlantError: the arm ran away"] * 6


def measured(case, trial, moc, dcac):
    """Errors and mu of one trial, all as multiples of one number."""
    return [
        Measurement(case, name, "circle", trial, 0, "whole", {c.metric: value for c in CLAIMS})
        for name, value in (("exact", moc), (MATCHED, dcac))
    ]


@pytest.fixture
def made():
    """As printed -10 %; one exchange turns that into +20 %, one does nothing, one is too noisy to tell."""
    cases = {name: Case(about=name) for name in ("printed", "decides", "idle", "noisy")}
    rng, found = np.random.default_rng(0), []
    for draw in ("0", "1"):
        for k in range(10):
            size = rng.uniform(1.0, 2.0)
            for case, ratio in (("printed", 0.9), ("decides", 1.2), ("idle", 0.9), ("noisy", 0.2 if k % 2 else 2.0)):
                found += measured(case, f"{draw}/circle/{k}", size * ratio * rng.uniform(0.99, 1.01), size)
    return Ablation(draws=2, cases=cases), found


def test_what_decides_follows_from_the_numbers(made):
    table = ablation.rows(*made)
    assert {row["draw"] for row in table} == {"0", "1", ALL}
    tip = {row["case"]: row for row in table if (row["draw"], row["claim"]) == (ALL, "tip")}
    assert tip["printed"]["effect_percent"] == pytest.approx(-10.0, abs=0.5)
    assert tip["decides"]["shift_percent"] == pytest.approx(30.0, abs=0.5)
    assert tip["decides"]["shift_percent_low"] > 29.0
    assert {name: row.get("decides") for name, row in tip.items()} == {
        "printed": None, "decides": True, "idle": False, "noisy": False,
    }  # fmt: skip
    assert {name: row["confirmed"] for name, row in tip.items() if name != "noisy"} == {
        "printed": True, "decides": False, "idle": True,
    }  # fmt: skip
    said = " ".join(ablation.headline(table))
    assert "tip, rcm confirmed" in said
    assert "decides (mu, tip, rcm)" in said
    assert "idle" not in said
    assert ablation.headline([]) == []
    other = [{**row, "controller": DAMPED if row["case"] == "decides" else "exact"} for row in table]
    assert "no exchange" in " ".join(ablation.headline(other))


def test_trials_that_broke_off_on_one_side_are_left_out_of_the_shift(made):
    settings, found = made
    short = [m for m in found if (m.group, m.controller, m.trial) != ("decides", MATCHED, "0/circle/3")]
    [row] = [
        row for row in ablation.rows(settings, short)
        if (row["case"], row["draw"], row["claim"]) == ("decides", ALL, "tip")
    ]  # fmt: skip
    assert row["trials"] == 19
    assert row["decides"] is True


def test_the_table_has_a_row_for_every_case_and_draw(made):
    table = ablation_table(ablation.rows(*made))
    assert len(table.rows) == 4 * 3
    assert table.rows[0]["holds"] == "tip, rcm"
