"""The study of the arm's defects: the same trials in every plant, figures from the traces, a page that it writes."""

import json

import pyarrow.parquet as pq
import pytest

from benchmarks import plant
from benchmarks.common.markdown import write_section
from benchmarks.common.output import default_config
from benchmarks.paper_experiment.trials import variant
from benchmarks.plant_study import page, runs
from moc_opt import scenario
from moc_opt.errors import MocOptError
from moc_opt.scenario import Setup, run
from moc_opt.trace.metrics import summarize
from tests import first_screens

TINY = """
tasks = ["circle"]
trials = 1
processes = 1
presets = ["tuned"]
[base]
calibration_error_m = 0.0
calibration_tilt_rad = 0.0
encoder_bias_rad = 0.0
[effects.none]
[effects.bias]
encoder_bias_rad = 0.001
[calibration]
trials = 1
duration_s = 3.0
sizes = [0.5]
[scenario]
judge = false
bound_samples = 0
duration_s = 0.3
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    out = tmp_path_factory.mktemp("plant")
    file = out / "tiny.toml"
    file.write_text(TINY)
    assert plant.main([str(file), "--out", str(out / "results"), "--seed", "3"]) == 0
    return plant.Config.load(file), out / "results"


def test_files_and_figures(results):
    config, out = results
    summary = json.loads((out / "summary.json").read_text())["tuned"]
    assert set(summary) == {"none, dcac", "none, exact", "bias, dcac", "bias, exact"}
    none, bias = summary["none, exact"], summary["bias, exact"]
    assert none["broke_off"] == 0
    assert none["tip_error_mean_mm"] == none["tip_error_registered_mean_mm"] == none["tip_error_model_mean_mm"]
    assert bias["tip_error_mean_mm"] > 0.2
    assert bias["tip_error_registered_mean_mm"] < 0.3 * bias["tip_error_mean_mm"]
    assert bias["rcm_error_mean_mm"] > bias["rcm_error_registered_mean_mm"]
    assert "mu_gain_percent" in none
    assert "mu_gain_percent" not in summary["none, dcac"]
    rows = pq.read_table(out / "rows.parquet").to_pylist()
    assert [row["part"] for row in rows].count("calibration") == 2 * 4
    rows = [row for row in rows if row["part"] != "calibration"]
    assert len(rows) == 4
    environment = json.loads((out / "environment.json").read_text())
    assert (environment["seed"], environment["config"]["effects"]["bias"]) == (3, {"encoder_bias_rad": 0.001})
    job = next(job for job in config.model_copy(update={"seed": 3}).jobs() if job.about["effect"] == "bias")
    again = summarize(run(variant(job.trial, "exact")))
    mine = next(row for row in rows if (row["effect"], row["controller"]) == ("bias", "exact"))
    assert mine["tip_error_mean_mm"] == pytest.approx(again["tip_error_mean_mm"], rel=1e-12)


def test_a_moving_elbow_costs_what_registering_again_gives_back(results):
    """By one trial: the registered tip error of MOC is far above DCAC's, and comes down to it; no verdict is given."""
    _, out = results
    summary = json.loads((out / "summary.json").read_text())
    by = {(row["kind"], row["size"]): row for row in summary["calibration"]}
    assert set(by) == {(kind, size) for kind in runs.KINDS for size in (0.0, 0.5)}
    none, origins = by["origins", 0.0], by["origins", 0.5]
    assert none["moc_tip_after"] == pytest.approx(none["moc_tip_again"], rel=1e-6)
    assert origins["moc_tip_error_registered"] > 2.0 * origins["dcac_tip_error_registered"]
    assert origins["moc_tip_again"] < 0.5 * origins["moc_tip_after"]
    assert origins["moc_rcm_again"] < 0.7 * origins["moc_rcm_after"]
    assert origins["moc_tip_error_model"] == pytest.approx(none["moc_tip_error_model"], rel=0.2)
    assert all("too few trials to decide" in row["undecided"] for row in summary["break_even"])
    first_screens.check((out / "report.html").read_text(), pictures=1)


def test_a_registration_at_the_start_is_the_runs_own():
    """What is registered at tick 0 by `after_travel` is what the run itself counts from."""
    sweep = {"trials": 1, "sizes": [0.5], "duration_s": 0.6}
    job = plant.Config(tasks=["circle"], presets=["tuned"], seed=2, calibration=sweep).calibration_jobs()[-1]
    setup = Setup(job.trial)
    trace = setup.trace()
    found = runs.after_travel(trace, setup, 0)
    assert found["tip_again"] == pytest.approx(found["tip_after"], abs=1e-6)
    assert found["rcm_again"] == pytest.approx(found["rcm_after"], abs=1e-6)
    assert found["tip_again"] < 0.5 < 1e3 * trace.tip_error_m.mean()


@pytest.mark.parametrize(
    ("values", "at"),
    [((0.0, 10.0, 20.0), 0.5), ((6.0, 7.0, 8.0), 0.0), ((0.0, 9.0, 4.0), None), ((9.0, 1.0, 9.0), 1.5)],
)
def test_where_a_limit_is_crossed_for_good(values, at):
    assert page.crossing((0.0, 1.0, 2.0), values, 5.0) == at


def test_every_effect_is_run_on_the_same_trials():
    config = plant.Config.load(default_config("plant"))
    jobs = config.jobs()
    assert len(jobs) == len(config.presets) * len(config.effects) * config.trials * len(config.tasks)
    starts = {job.about["effect"]: [] for job in jobs}
    for job in jobs:
        starts[job.about["effect"]].append((job.about["preset"], job.trial.seed, job.trial.task, job.trial.start))
    assert all(trials == starts["none"] for trials in starts.values())
    assert config.plant("default") == config.scenario.plant
    assert config.plant("none").encoder_bias_rad == config.plant("none").calibration_error_m == 0.0


def test_what_is_wrong_is_said(tmp_path, capsys):
    file = tmp_path / "bad.toml"
    file.write_text(TINY.replace("encoder_bias_rad = 0.001", "encoder_bais_rad = 0.001"))
    assert plant.main([str(file), "--out", str(tmp_path)]) == 2
    assert "did you mean 'encoder_bias_rad'" in capsys.readouterr().err


def test_a_run_that_breaks_off_is_counted(monkeypatch, results):
    config, _ = results
    monkeypatch.setattr(scenario, "run", lambda case: (_ for _ in ()).throw(MocOptError("gone")))
    rows = [row for job in config.jobs() for row in runs.run_job(job)]
    assert {row["ended"] for row in rows} == {"MocOptError: gone"}
    assert page.effects_summary(rows)["tuned"]["bias, exact"] == {"runs": 1, "broke_off": 1}


def test_the_pages_section_is_written_between_its_marks(results, tmp_path):
    config, out = results
    rows = [
        {name: value for name, value in row.items() if value is not None}
        for row in pq.read_table(out / "rows.parquet").to_pylist()
    ]
    effects, sweep = ([row for row in rows if row["part"] == part] for part in ("effects", "calibration"))
    file = tmp_path / "plant.md"
    marks = [f"<!-- {name} -->\nold\n<!-- /{name} -->" for name in ("plant", "calibration")]
    file.write_text("\n".join(["before", *marks, "after\n"]))
    write_section(file, "plant", page.effects_markdown(page.effects_summary(effects), 3))
    write_section(file, "calibration", page.sweep_markdown(page.sweep_summary(sweep, config.solver), 3))
    lines = file.read_text().splitlines()
    assert (lines[0], lines[-1]) == ("before", "after")
    assert "old" not in lines
    assert sum(line.startswith("| bias, ") for line in lines) == 2
    assert sum(line.startswith(("| tuned | nothing | ", "| tuned | origins 0.5 | ")) for line in lines) == 2
