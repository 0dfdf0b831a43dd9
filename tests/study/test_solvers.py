import json
from pathlib import Path

import polars as pl
import pytest

from moc_opt.study import solvers, testsets
from moc_opt.study.solvers import PARTS, Config
from moc_opt.study.trials import BASELINE
from tests import broken_solvers

SMALL = """
seed = 3
processes = 2
open_loop = { ticks = 40, cold = 5 }
closed_loop = { tasks = ["circle"], trials = 3, cited = ["exact"], others = 2, duration_s = 0.2 }
scenario.bound_samples = 2
[testsets]
names = ["circle", "infeasible"]
timed = ["circle"]
every = 16
rounds = 2
seconds = 0.1
patience_s = 1.5
cold = 4
"""


@pytest.fixture(autouse=True)
def quiet_machine(monkeypatch):
    monkeypatch.setattr("moc_opt.study.timing.quiet", lambda row: True)


def run(folder: Path, *more: str, names: tuple[str, ...] = ("exact", "osqp", "rnn", "quadprog")) -> int:
    (folder / "small.toml").write_text(SMALL)
    return solvers.main([str(folder / "small.toml"), "--out", str(folder / "out"), "--only", *names, *more])


def test_second_run_reuses_all_results(tmp_path, capsys):
    out = tmp_path / "out"
    assert run(tmp_path, "--parts", *PARTS) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert {"testset circle", "testset infeasible", "settings", "not_run"} <= set(summary)
    assert {"osqp@default", "osqp@tight", "osqp@recommended", "rnn@semi-implicit-10"} <= set(summary["testsets"])
    answered = {"claimed_solved", "verified_solved", "silently_wrong", "primal_max", "natural_max", "loss_max"}
    assert answered | {"solve_p50_us", "solve_p99_us", "timed_solves"} <= set(summary["open_loop_warm"]["osqp"])
    assert "setup_p50_us" in summary["open_loop_cold"]["osqp"]
    looped = {"mu_mean", "mu_gain_percent", "mu_fraction_of_best", "tip_error_registered_change_percent", "tick_p99_us",
              "tick_p99_9_us", "deadline_misses"}  # fmt: skip
    assert answered - {"primal_max"} | looped <= set(summary["closed_loop"]["osqp"])
    counts = {name: (row["trials"], row["whole"]) for name, row in summary["closed_loop"].items()}
    assert counts == {BASELINE: (3, 3), "exact": (3, 3), "osqp": (2, 2), "rnn": (2, 2), "quadprog": (2, 2)}
    rows = pl.read_parquet(out / "rows.parquet")
    mine = rows.filter((pl.col("part") == "testset") & (pl.col("set") == "circle") & (pl.col("solver") == "osqp"))
    assert len(mine) == 8 + 2 + 2, "all 8 problems with recommended settings, 2 with default and 2 with tight settings"
    loop = rows.filter(pl.col("controller").is_not_null())
    assert (len(loop), loop["seed"].n_unique()) == (3 + 3 + 2 + 2 + 2, 3)

    capsys.readouterr()
    assert run(tmp_path, "--parts", *PARTS) == 0
    again = json.loads((out / "summary.json").read_text())
    assert again | {"clock": None} == summary | {"clock": None}
    shown, progress = capsys.readouterr()
    _, *so_far = progress.split("so far: ")
    assert so_far[0].startswith("Use `exact`")
    assert len(set(so_far)) == len(so_far), "no sentence is said twice"
    assert max(len(line) for line in shown.splitlines() if str(tmp_path) not in line) <= 80


def test_broken_solvers_do_not_disturb_the_others(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(broken_solvers.install(tmp_path / "plugin")))
    monkeypatch.setattr("moc_opt.study.trials.PATIENCE_S", 3.0)
    monkeypatch.setattr("moc_opt.study.trials.PER_S", 1.0)
    names = ("hangs", "exact", "crashes", "raises")
    assert run(tmp_path, "--parts", "testsets", "closed_loop", "--sets", "circle", "--json", names=names) == 0
    summary = json.loads(capsys.readouterr().out)
    table, loop = summary["testsets"], summary["closed_loop"]
    assert (table["hangs@recommended"]["hung"], table["crashes@recommended"]["crashed"]) == (1, 1)
    assert table["exact@recommended"]["verified_solved"] == table["exact@recommended"]["feasible"]
    assert {name: row["trials"] - row["whole"] for name, row in loop.items()} == {
        BASELINE: 0, "hangs": 2, "exact": 0, "crashes": 2, "raises": 0,
    }  # fmt: skip
    assert "hung" in loop["hangs"]["reason"]
    assert "SIGSEGV" in loop["crashes"]["reason"]
    for said, row in (("first at 0.006 s", loop["raises"]), ("problem 3", table["raises@recommended"])):
        assert f"{said}: ZeroDivisionError: division by zero (broken_solvers_plugin.py, line 38)" in row["trouble"]


def test_wrong_input_is_refused_with_the_nearest_name(tmp_path, capsys):
    for arguments, text, cure in (
        (["--only", "osqq"], "", "'osqp'"), (["--sets", "circel"], "", "'circle'"),
        ([], "[testsets]\ntimed = ['circel']", "'circle'"), ([], "parts = ['testset']", "'testsets'"),
    ):  # fmt: skip
        (tmp_path / "asked.toml").write_text(text)
        assert solvers.main([str(tmp_path / "asked.toml"), *arguments, "--out", str(tmp_path)]) == 2
        assert cure in capsys.readouterr().err


def test_shipped_configuration_is_the_default():
    config = Config.load(Path(solvers.__file__).with_name("solvers.toml"))
    assert (config, config.parts) == (Config(), list(PARTS))
    names = (BASELINE, "exact", "rnn", "rnn-printed", "osqp")
    assert [config.closed_loop.of(name) for name in names] == [60, 60, 60, 60, 15]
    assert len({case.seed for case in config.cases()}) == 60
    full = Config.load(solvers.FULL)
    assert {*full.testsets.timed, *full.testsets.timed_too} == set(testsets.NAMES)
    names, left_out = solvers.once(["exact", "daqp", "qpsolvers:daqp", "qpsolvers:scs"])  # no library runs twice
    assert names == ["exact", "daqp", "qpsolvers:scs"]
    assert "`daqp`" in left_out["qpsolvers:daqp"]
