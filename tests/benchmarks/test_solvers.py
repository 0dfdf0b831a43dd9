"""python -m benchmarks.solvers: its files, its parts, that it resumes, and that broken solvers do not stop it."""

import json
from functools import partial

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks import solvers
from benchmarks.common.output import default_config
from benchmarks.solver_study import closed_loop, combine
from benchmarks.solver_study import tables as study_tables
from benchmarks.solver_study.answers import Part
from benchmarks.solver_study.cells import Cell, costs_of, load, totals
from benchmarks.solver_study.config import PARTS, Config, TestSets
from benchmarks.solver_study.headline import headline
from benchmarks.solver_study.settings import SolverSetting
from benchmarks.solver_study.tables import tables
from benchmarks.subproblems.testset import TestSet
from moc_opt.errors import ScenarioError, UnknownNameError
from moc_opt.scenario import Scenario
from moc_opt.study import run as do
from moc_opt.study.timing import Disturbance
from tests import broken_solvers

SMALL = """
seed = 3
processes = 2
parts = ["open_loop", "testsets", "growth", "closed_loop", "sweeps", "duals"]
[open_loop]
ticks = 40
cold = 5
[testsets]
names = ["circle", "infeasible"]
timed = ["circle"]
every = 16
rounds = 2
seconds = 0.1
patience_s = 1.5
cold = 4
[growth]
joints = [7, 9]
[closed_loop]
tasks = ["circle"]
trials = 3
cited = ["exact"]
others = 2
duration_s = 0.2
[sweeps]
trials = 2
duration_s = 0.2
values = "few"
deadline_solvers = ["osqp"]
late_percent = [10.0]
[scenario]
bound_samples = 2
"""
NAMES = ["exact", "osqp", "rnn", "quadprog"]


@pytest.fixture(scope="module", autouse=True)
def quiet_machine():
    """What else runs beside these tests decides nothing in them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Disturbance, "trusts", lambda *_: True)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A whole small study, in a folder of results."""
    root = tmp_path_factory.mktemp("study") / "results"
    root.mkdir()
    (root / "small.toml").write_text(SMALL)
    assert run(root) == 0
    return root


def run(root, *more, names=NAMES):
    return solvers.main([str(root / "small.toml"), "--out", str(root / "out"), "--only", *names, *more])


@pytest.fixture(scope="module")
def summary(folder):
    return json.loads((folder / "out" / "summary.json").read_text())


def test_every_part_is_there(summary):
    expected = {
        "open_loop_warm", "open_loop_cold", "testsets", "testset circle", "testset infeasible", "growth",
        "closed_loop", "courses", "sweep osqp.eps", "sweep damping", "sweep k0", "sweep deadline.osqp", "prediction",
        "disagreements", "cost_begins", "duals on six rows", "duals on five rows", "settings", "not_run", "clock",
    }  # fmt: skip
    assert expected <= set(summary)
    assert set(summary["closed_loop"]) == {"dcac", *NAMES} - set(summary["not_run"])
    assert set(summary["courses"]) == set(summary["closed_loop"])
    assert {"osqp@default", "osqp@tight", "osqp@recommended", "rnn@semi-implicit-10"} <= set(
        summary["testsets"]
    )


def test_the_names_of_the_metrics_are_those_that_others_read(summary):
    warm = summary["open_loop_warm"]["osqp"]
    for name in ("solve_p50_us", "solve_p99_us", "claimed_solved", "verified_solved", "silently_wrong", "primal_max",
                 "natural_max", "loss_max"):  # fmt: skip
        assert name in warm
    assert "setup_p50_us" in summary["open_loop_cold"]["osqp"]
    for name in ("mu_mean", "mu_final", "mu_gain_percent", "mu_fraction_of_bound", "tip_error_max_mm",
                 "trocar_force_mean_N", "tick_p99_us", "deadline_misses"):  # fmt: skip
        assert name in summary["closed_loop"]["osqp"]
    for point in [
        p for part, points in summary.items() if part.startswith("sweep ") for p in points.values()
    ]:
        assert "mu_fraction_of_bound" in point or point["broke_off"]


def test_no_mean_of_times_hides_a_tail(summary):
    def keys(value):
        if isinstance(value, dict):
            for key, inner in value.items():
                yield key
                yield from keys(inner)

    assert [
        k for k in keys(summary) if k.endswith("_us") and "mean" in k and not k.startswith("shgeom")
    ] == []


def test_broken_solvers_are_recorded_and_the_others_unharmed(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(broken_solvers.install(tmp_path / "plugin")))
    monkeypatch.setattr(closed_loop, "PATIENCE_S", 4.0)
    arguments = [
        "--parts",
        "testsets",
        "closed_loop",
        "--sets",
        "circle",
        "--out",
        str(tmp_path / "out"),
        "--json",
    ]
    assert run(folder, *arguments, names=["hangs", "exact", "crashes", "raises"]) == 0
    summary = json.loads(capsys.readouterr().out)
    table = summary["testsets"]
    assert table["hangs@recommended"]["hung"] == 2
    assert table["crashes@recommended"]["crashed"] == 2
    assert table["exact@recommended"]["verified_solved"] == table["exact@recommended"]["feasible"]
    assert summary["closed_loop"]["hangs"]["broke_off"] == 2
    assert "hung" in summary["closed_loop"]["hangs"]["reason"]
    assert "SIGSEGV" in summary["closed_loop"]["crashes"]["reason"]
    assert summary["closed_loop"]["exact"]["broke_off"] == 0
    assert summary["closed_loop"]["raises"]["broke_off"] == 0
    told = {(row["solver"], row["part"]): row["trouble"] for row in tables(summary)["troubles"].rows}
    assert "problem 3: ZeroDivisionError: division by zero" in told["raises@recommended", "testsets"]
    assert "first at 0.006 s: ZeroDivisionError: division by zero" in told["raises", "closed_loop"]
    assert "SIGSEGV" in told["crashes@recommended", "testsets"]
    assert not [solver for solver, _ in told if solver.startswith("exact")]
    said = headline(summary, {})
    assert "Never returned: hangs@recommended" in said
    assert "Took their process with them: crashes@recommended" in said


def test_counts_add_up(summary):
    for part, found in summary.items():
        if part.startswith("testset"):
            for m in found.values():
                assert m["verified_solved"] + m["infeasible_right"] == m["right"]
                asked = ("optima_asked", "infeasible_asked", "refused_inconsistent")
                assert sum(m[key] for key in asked) == m["solves"]
                assert m["verified_solved"] <= m["optima_asked"]
                assert m["infeasible_right"] <= m["infeasible_asked"]
                assert m["refused_inconsistent"] <= m["inconsistent_asked"]
                parts = (
                    "claimed_solved",
                    "infeasible_right",
                    "refused_inconsistent",
                    "failed",
                    "hung",
                    "crashed",
                )
                assert sum(m[key] for key in parts) + m["not_asked"] == m["solves"]
                assert m["verified_solved"] + m["silently_wrong"] == m["claimed_solved"]


def test_all_files_are_written(folder, summary):
    out = folder / "out"
    rows = pq.read_table(out / "rows.parquet").to_pylist()
    assert {"open_loop_warm", "open_loop_cold", "testset", "closed_loop"} <= {row["part"] for row in rows}
    mine = [r for r in rows if r["part"] == "testset" and r["set"] == "circle" and r["solver"] == "osqp"]
    assert len(mine) == 8 + 2 + 2, "every problem as we recommend it, every fourth as the library comes and tight"
    environment = json.loads((out / "environment.json").read_text())
    assert environment["config"]["testsets"]["every"] == 16
    page = (out / "report.html").read_text()
    for words in (
        "Performance profiles",
        "How to read this",
        "Where inaccuracy begins to cost",
        "Deadlines",
        "nlp-*",
        'id="map"',
        'href="replay.html"',
        "its first 0.2 s",
    ):
        assert words in page
    assert (out / "replay.html").stat().st_size > 10_000
    assert np.load(out / "solve_us_osqp.npy").shape == (100,)
    assert 'href="out/report.html"' in (folder / "index.html").read_text()
    assert page.index('id="accuracy-against-time"') < page.index('class="section"'), "pictures before what is folded"


def test_a_second_run_takes_all_parts_from_the_first(folder, summary, capsys):
    """Nothing is measured again, so that even the times are the same."""
    assert run(folder) == 0
    again = json.loads((folder / "out" / "summary.json").read_text())
    for part in set(summary) - {"clock"}:
        assert again[part] == summary[part], part
    said = capsys.readouterr().out
    assert "jobs are those of an earlier run" in said
    assert max(len(line) for line in said.splitlines() if str(folder) not in line) <= 80, "but for paths"
    assert "…" not in said
    assert said.index("osqp") < said.index("written:")


def test_parts_and_sets_can_be_chosen(folder, tmp_path, capsys):
    arguments = [str(folder / "small.toml"), "--out", str(tmp_path), "--only", "exact", "--json"]
    assert solvers.main([*arguments, "--parts", "testsets", "--sets", "spiral"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert "testset spiral" in found
    assert not {"testset circle", "closed_loop", "open_loop_warm"} & set(found)


def test_wrong_input_is_refused_with_the_nearest(tmp_path, capsys):
    assert solvers.main(["--only", "osqq", "--out", str(tmp_path)]) == 2
    assert "'osqp'" in capsys.readouterr().err
    assert solvers.main(["--sets", "circel", "--out", str(tmp_path)]) == 2
    assert "'circle'" in capsys.readouterr().err
    (tmp_path / "bad.toml").write_text("[testsets]\nroundz = 1")
    assert solvers.main([str(tmp_path / "bad.toml"), "--out", str(tmp_path)]) == 2
    assert "roundz" in capsys.readouterr().err
    with pytest.raises(ScenarioError):
        Config.load(tmp_path / "none.toml")
    with pytest.raises(UnknownNameError):
        TestSets(names=["nothing"])


def test_the_shipped_configuration_is_that_of_the_program():
    config = Config.load(default_config("solvers"))
    assert config == Config()
    assert set(config.parts) == {*PARTS} - {"qpbenchmark"}
    assert config.quick().testsets.every > 1
    full = config.full()
    assert full.testsets.rounds > config.testsets.rounds
    assert full.growth.joints == list(range(7, 15))
    assert full.twice
    assert set(full.parts) == set(PARTS)
    loop = config.closed_loop
    assert {name: loop.of(name) >= 60 for name in ("dcac", "exact", "rnn", "rnn-printed", "osqp")} == {
        "dcac": True, "exact": True, "rnn": True, "rnn-printed": True, "osqp": False,
    }  # fmt: skip
    assert loop.of("osqp") >= 15
    assert config.sweeps.trials >= 9  # points are compared with each other on the same trials
    long = Config.load(default_config("solvers-long"))
    assert long.twice
    assert set(long.parts) == set(PARTS)
    assert set(long.testsets.times(recommended=True)) == set(long.testsets.chosen())
    assert long.closed_loop.short == []
    assert long.testsets.every_other == 1
    assert long.sweeps.duration_s == long.closed_loop.duration_s
    assert long.sweeps.trials >= 15


def test_a_library_is_asked_once():
    names, left_out = solvers.once(["exact", "daqp", "qpsolvers:daqp", "qpsolvers:scs"])
    assert names == ["exact", "daqp", "qpsolvers:scs"]
    assert list(left_out) == ["qpsolvers:daqp"]
    assert "`daqp`" in left_out["qpsolvers:daqp"]


def test_slow_solvers_run_the_beginning_and_are_compared_with_the_same_ticks():
    trial = Scenario(duration_s=0.2, bound_samples=2, seed=4)
    settings = {"exact": {}, "clarabel": {}}
    shown = []
    runs = closed_loop.run_all(
        partial(do, workers=1), {"a": trial.change(name="a")}, settings, short=["clarabel"], short_s=0.1,
        show=shown.append,
    )  # fmt: skip
    assert {run.controller: run.short for run in runs} == {"dcac": False, "exact": False, "clarabel": True}
    assert {run.controller: run.metrics["ticks"] for run in runs} == {"dcac": 100, "exact": 100, "clarabel": 50}
    assert [[run.controller for run in one] for one in shown] == [[run.controller for run in runs]]
    whole, beginning = combine.summary(runs), combine.summary([run.beginning for run in runs])
    for metric in ("mu_mean", "mu_gain_percent", "tip_change_percent", "rcm_error_model_mean_mm"):
        assert beginning["exact"][metric] == pytest.approx(beginning["clarabel"][metric], rel=1e-3)
        assert whole["clarabel"][metric] == beginning["clarabel"][metric]
    assert whole["exact"]["mu_gain_percent"] != pytest.approx(whole["clarabel"]["mu_gain_percent"], rel=0.05)
    assert beginning["dcac"]["mu_gain_percent"] == whole["dcac"]["mu_gain_percent"] == 0.0
    assert (whole["clarabel"]["short_runs"], whole["exact"]["short_runs"]) == (1, 0)


def test_the_nonlinear_solvers_carry_their_footnote(summary):
    with_nlp = {
        **summary,
        "testset circle": {**summary["testset circle"], "nlp-sqp@recommended": {"solves": 8}},
    }
    assert "another problem" in tables(with_nlp)["testset circle"].caption
    assert tables(summary)["testset circle"].caption == ""
    wrong = {"nlp-sqp@recommended": {**summary["testsets"]["exact@recommended"], "silently_wrong": 8}}
    assert "nlp-sqp" not in headline({"testsets": {**summary["testsets"], **wrong}}, {})


def test_few_trials_make_no_claim():
    """Of fewer than eight trials no solver is named as best, no interval is given; with fewer trials none competes."""

    def said(trials):
        rows = {name: {"compared_trials": n, "mu_gain_percent": gain, "mu_gain_percent_low": gain - 1.0,
                       "mu_gain_percent_high": gain + 1.0}
                for name, gain, n in (("a", 12.5, trials), ("b", 3.0, trials), ("c", 90.0, trials - 1))}  # fmt: skip
        return headline({"closed_loop": rows}, {})

    assert "by +12.5 [11.5, 13.5] % with a and by +3 [2, 4] % with b" in said(8)
    for trials in (2, 7):
        assert f"too few trials to decide ({trials} of at least 8)" in said(trials)
        assert "12" not in said(trials)
        assert "[" not in said(trials)


def test_a_gain_of_other_ticks_is_not_compared():
    rows = {name: {"compared_trials": 15, "mu_gain_percent": gain, "short_runs": short} for name, gain, short in
            (("a", 12.5, 0), ("b", 3.0, 0), ("slow", 1.0, 15))}  # fmt: skip
    assert "with a and by +3 % with b" in headline({"closed_loop": rows}, {})


def test_growth_is_said_in_words():
    rows = {"a": {"solve_p50_us_14_over_7": 1.25, "solve_p50_us_n7": 9.0}, "b": {"solve_p50_us_14_over_7": 3.0}}
    said = headline({"growth": rows}, {})
    assert said == "From 7 to 14 joints the median time changes by a factor of 1.2 with a and of 3.0 with b."
    assert headline({"growth": {"c": {"solves": 0}}}, {}) == "Nothing was run."


def row(right, us, solves=100, **more):
    counts = dict.fromkeys(("silently_wrong", "refused_inconsistent", "hung", "crashed"), 0)
    return {**counts, "solves": solves, "feasible": solves, "verified_solved": right, "right": right,
            "solve_p50_us_worst_set": us, "relative_max": 1e-9, **more}  # fmt: skip


def test_fast_and_wrong_is_not_fastest():
    sets = {"quick@recommended": row(0, 0.1), "slow@recommended": row(100, 9.0), "good@recommended": row(99, 5.0),
            "nearly@recommended": row(98, 2.0)}  # fmt: skip
    said = headline({"testsets": sets}, {})
    assert "1 of 4 solvers answered every problem" in said
    assert "the fastest is good (99.0 %) with a median of 5.0 us" in said
    made = tables({"testsets": sets})["testsets"]
    (column,) = [c for c in made.columns if c.key == "solve_p50_us_worst_set"]
    best = [row["solver"] for row, cell in zip(made.rows, made.cells(column), strict=True) if cell.best]
    assert best == ["good@recommended"]


@pytest.mark.parametrize(("rows", "refused"), [(6, 7), (5, 0)])
def test_refused_inconsistent_rows_are_neither_right_nor_wrong(rows, refused):
    """Of eight problems one is answered. Six rows contradict each other, so the others may be refused; five do not."""
    kept = load("inconsistent-1e-4", 16)
    count = len(kept.rows)
    x = np.full((count, kept.n), np.nan)
    x[0] = TestSet.load(kept.name).x[0]
    answer = {"status": np.array(["solved"] + ["infeasible"] * (count - 1)), "iterations": np.ones(count, int),
              "x": x, "y": np.full((count, 6), np.nan)}  # fmt: skip
    setting = SolverSetting("osqp", "recommended", {"rows": rows}, "")
    cell = Cell(setting, kept, Part({"reason": "", "events": []}, answer))
    counts = cell.counts()
    assert cell.contradictory.all()
    assert kept.feasible.all()
    assert (counts["right"], counts["verified_solved"], counts["optima_asked"]) == (1, 1, count - refused)
    assert (counts["refused_inconsistent"], counts["inconsistent_asked"]) == (refused, count if rows == 6 else 0)
    assert counts["infeasible_wrong"] == counts["failed"] == count - 1 - refused
    costs = costs_of([cell], {kept.name: Part({}, {"solve_us": np.ones((2, count))})})
    assert np.isfinite(costs).sum() == 1
    found = {"testsets": {"osqp@recommended": totals([cell], {})}}
    assert headline(found, {}).startswith(f"{int(refused > 0)} of 1 solvers answered every problem")
    assert tables(found)["testsets"].rows[0]["right_percent"] == 100.0 / (count - refused)


def test_qpbenchmark_stands_beside_ours():
    ours = {f"qpsolvers:{n}@default": {"solves": 4, "feasible": 4, "right": v, "solve_p50_us_worst_set": t}
            for n, v, t in (("a", 4, 9.0), ("b", 4, 5.0), ("c", 2, 1.0))}  # fmt: skip
    theirs = {f"{n}@default": {"rank": r} for n, r in (("c", 1), ("b", 2), ("a", 3))}
    rows = study_tables._beside_ours({"testsets": ours, "qpbenchmark": theirs})
    assert {row["solver"][0]: row["our_rank"] for row in rows} == {"b": 1, "a": 2, "c": 3}
