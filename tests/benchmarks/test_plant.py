"""The study of the arm's defects: the same trials in every plant, figures from the traces, a page that it writes."""

import json

import pyarrow.parquet as pq
import pytest

from benchmarks import plant
from benchmarks.common.markdown import SectionError, write_section
from benchmarks.common.output import default_config
from benchmarks.paper_experiment.trials import variant
from benchmarks.plant_study import runs, tables
from moc_opt import scenario
from moc_opt.errors import MocOptError
from moc_opt.scenario import run

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
    return runs.Config.load(file), out / "results"


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
    assert len(rows) == 4
    environment = json.loads((out / "environment.json").read_text())
    assert (environment["seed"], environment["config"]["effects"]["bias"]) == (3, {"encoder_bias_rad": 0.001})
    job = next(job for job in config.model_copy(update={"seed": 3}).jobs() if job.effect == "bias")
    again = runs.measure(run(variant(job.trial, "exact")), None)
    mine = next(row for row in rows if (row["effect"], row["controller"]) == ("bias", "exact"))
    assert mine["tip_error_mean_mm"] == pytest.approx(again["tip_error_mean_mm"], rel=1e-12)


def test_every_effect_is_run_on_the_same_trials():
    config = runs.Config.load(default_config("plant"))
    jobs = config.jobs()
    assert len(jobs) == len(config.presets) * len(config.effects) * config.trials * len(config.tasks)
    starts = {job.effect: [] for job in jobs}
    for job in jobs:
        starts[job.effect].append((job.preset, job.trial.seed, job.trial.task, job.trial.start))
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
    assert tables.summarise(config, rows)["tuned"]["bias, exact"] == {"runs": 1, "broke_off": 1}


def test_the_page_keeps_its_words(results, tmp_path):
    config, out = results
    text = tables.page_text(json.loads((out / "summary.json").read_text()), config)
    page = tmp_path / "plant.md"
    page.write_text("before\n<!-- plant -->\nold\n<!-- /plant -->\nafter\n")
    write_section(page, "plant", text)
    lines = page.read_text().splitlines()
    assert (lines[0], lines[-1]) == ("before", "after")
    assert "old" not in lines
    assert sum(line.startswith("| bias | ") for line in lines) == 2
    page.write_text("no marks")
    with pytest.raises(SectionError, match="no lines <!-- plant -->"):
        write_section(page, "plant", text)
