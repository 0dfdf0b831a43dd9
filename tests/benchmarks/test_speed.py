"""The speed benchmark: what it compares does the same work, its ratios are of times side by side, goals are judged."""

import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks import speed
from benchmarks.common.goals import verdicts
from benchmarks.common.output import default_config
from benchmarks.latency import runs
from benchmarks.latency.bare import LIBRARIES, by_hand
from benchmarks.latency.page import answer, report, tables
from benchmarks.latency.verdict import GOALS
from moc_opt.figures.notation import Doubtful
from moc_opt.qp.problem import compute_residuals
from moc_opt.scenario import Scenario, Setup
from moc_opt.solvers import Status, available, create
from moc_opt.solvers.exact import Exact
from tests import first_screens
from tests.problems import unstructured_problems

INSTALLED = [name for name in LIBRARIES if available().get(name, "") is None]


@pytest.fixture(scope="module")
def sequence():
    return unstructured_problems(7, 120, np.random.default_rng(4))


# --- the libraries by hand ---


@pytest.mark.parametrize("name", INSTALLED)
def test_by_hand_the_answer_is_the_adapter_s_and_optimal(name, sequence):
    solver = create(name)
    session, library = solver.start(sequence[0]), by_hand(name, solver, sequence[0])
    answers = [library(qp) for qp in sequence]
    theirs = [session.solve(qp) for qp in sequence]
    X = np.array([x for x, _ in answers])
    for x, solution in zip(X, theirs, strict=True):
        np.testing.assert_allclose(x, solution.x, atol=1e-4)
    found = compute_residuals(np.array([qp.row for qp in sequence]), X)
    solved = np.array([solution.status is Status.SOLVED for solution in theirs])  # osqp gives up on one of them
    assert solved.mean() > 0.98
    assert (found.primal[solved] < 1e-6).all()
    assert (found.relative[solved] < 1e-3).all()
    # The multipliers: P x + p + A^T y vanishes inside the box, in the library's own scale and sign.
    qp, (x, y) = sequence[0], by_hand(name, solver, sequence[0])(sequence[0])
    inside, scale = (x > qp.lower + 1e-6) & (x < qp.upper - 1e-6), solver.cost_scale
    slopes = [scale * (qp.P @ x + qp.p) + sign * (qp.reduced().A.T @ y) for sign in (1.0, -1.0)]
    ends = [np.abs(slope[inside]).max() for slope in slopes]
    assert np.shape(y) == (5,)
    assert min(ends) < 1e-4 * max(ends)


def test_what_does_other_work_is_not_compared(sequence, monkeypatch):
    def lazy(at, scale, m, n):
        x = create("exact").start(sequence[0]).solve(sequence[0]).x
        return lambda qp: (x, np.zeros(5))

    assert runs.disagreement(INSTALLED[0], create(INSTALLED[0]), sequence) is None
    monkeypatch.setitem(LIBRARIES, INSTALLED[0], lazy)
    assert "differ by" in runs.disagreement(INSTALLED[0], create(INSTALLED[0]), sequence)


# --- what is timed ---


def test_what_was_recorded_is_what_the_run_asked():
    scenario = Scenario(judge=False, bound_samples=0, duration_s=0.2)
    inputs, problems = runs.record(scenario)
    trace = Setup(scenario).trace()
    assert len(inputs) == len(problems) == len(trace) == 100
    np.testing.assert_array_equal([qp.row for qp in problems], trace.subproblem)
    np.testing.assert_array_equal([given[2][0] for given in inputs], trace.tip_ref_m)


def test_a_batch_is_solved_whole_by_one_thread_and_by_two(sequence, monkeypatch):
    asked = []

    class Counting(Exact):
        def solve_batch(self, rows, threads=None):
            asked.append((len(rows), threads))
            return super().solve_batch(rows, threads)

    monkeypatch.setattr(runs, "Exact", Counting)
    found = runs.batch(sequence[:7], 2500)
    assert asked == [(1000, None), (2500, 1), (2500, 1), (2500, 2), (2500, 2)]
    assert found["batch"] == 2500
    assert found["batch_two_threads_per_s"] > 0.0


def test_ratios_are_those_of_the_same_round():
    """One slow round in three changes no ratio: it slows both sides of it."""
    slow = np.array([1.0, 10.0, 1.0])
    found = runs.loop_ratios(40.0 * slow, np.array([9.0, 99.0, 9.0]), 1.0)
    assert found == {"steps_us": 9.0, "limit_us": 10.0, "python_over_limit": 4.0}
    assert set(runs.loop_ratios(slow, slow, None)) == {"steps_us"}


def test_the_limit_steps_through_the_states_of_the_run():
    """From each state one control period leads to the next; the forces of its steps differ by one step's motion."""
    steps = runs.Steps(Scenario(judge=False, bound_samples=0, duration_s=1.0))
    after, n = steps.stepped(), 7
    assert len(steps.states) == 500
    np.testing.assert_allclose(after[:-1, 0], steps.states[1:, 0], rtol=1e-12)
    moved = np.abs(np.diff(steps.states[:, 1 : 1 + n], axis=0))
    assert np.abs(after[:-1, 1 : 1 + n] - steps.states[1:, 1 : 1 + n]).max() < 0.01 * moved.max()
    assert steps.us() > 0.0


def test_times_of_new_processes_are_those_they_tell(monkeypatch):
    monkeypatch.setattr(runs, "FIRST_TICK", "print('{\"first_tick_s\": 1.5}')")
    monkeypatch.setattr(runs, "FIRST_RUN", ("-c", "import os; assert not os.listdir(os.environ['HOME'])"))
    bench, told = runs.Bench(), []
    found = runs.fresh(bench, 2, told.append)
    assert found["first_tick_s"] == 1.5
    assert found["first_run_s"] > 0.0
    assert len(bench.rows) == len(told) == 4


# --- goals, report, command ---


def made_up(**changes):
    """A summary with a number for everything that the report and the goals ask for."""
    times = {"tick_p50_us": 20.0, "tick_p99_us": 30.0, "tick_p99_9_us": 90.0}
    summary = {
        "tick": {"exact": times, "c": {**times, "tick_p50_us": 3.0}},
        "tick_parts": {"solver": times},
        "peers": {"pink-trimmed": {**times, "level": "velocity", "installed": "make", "tip_error_max_mm": 0.1,
                                   "tick_p50_us": 300.0, "times_ours": 15.0}},
        "batch": {"exact": {"batch": 1e6, "batch_one_thread_per_s": 2.1e6, "batch_two_threads_per_s": 4.2e6}},
        "adapters": {"exact": {"adapter_p50_us": 1.0},
                     "daqp": {"ratio": 1.04, "by_hand_p50_us": 10.0, "ratio_of_exact": 0.1}},
        "loop": {"python": {"factor": 40.0, "us_per_tick": 50.0, **times},
                 "limit": {"python_over_limit": 2.9, "steps_us": 12.0}},
        "setup": {"first_tick_s": 0.4, "first_run_s": 8.0, "libraries_s": 0.3, "model_s": 0.1, "start_and_tick_s": 0.0},
        "not_run": {},
        **changes,
    }  # fmt: skip
    summary["goals"] = verdicts(summary, GOALS)
    return summary


def test_goals_are_reached_by_a_summary_that_reaches_them():
    found = made_up()["goals"]
    assert {goal["reached"] for goal in found.values()} == {"yes"}
    assert set(found) == set(GOALS)
    assert found["batch"]["value"] == 4.2
    assert found["exact"]["made_of"] == "1.00 and 10.00 us"


def test_goals_that_are_missed_or_not_measured_say_so():
    fewer = {"batch": 250_000, "batch_one_thread_per_s": 2e6, "batch_two_threads_per_s": 4e6}
    worse = made_up(
        adapters={"exact": {"adapter_p50_us": 1.0}, "daqp": {"by_hand_p50_us": 5.0, "ratio_of_exact": 0.2}}, peers={},
        batch={"exact": fewer}, loop={"python": {"factor": 29.0}, "limit": {}}, setup={"first_tick_s": 0.6},
    )["goals"]  # fmt: skip
    reached = {name: goal["reached"] for name, goal in worse.items()}
    assert reached == {
        "first_torque": "no", "first_run": "not measured", "exact": "no", "batch": "not measured",
        "tick": "not measured", "c_tick": "yes", "limit": "not measured",
    }  # fmt: skip
    assert all((worse[name]["value"] is None) == (word == "not measured") for name, word in reached.items())


def test_a_goal_is_open_where_other_work_may_have_missed_it():
    times = {"tick_p50_us": Doubtful(3.0), "tick_p99_us": Doubtful(30.0), "tick_p99_9_us": Doubtful(4000.0)}
    spoilt = made_up(
        tick={"exact": times, "c": times}, peers={"pink-trimmed": {"tick_p50_us": 300.0, "times_ours": Doubtful(15.0)}}
    )
    assert spoilt["goals"]["c_tick"]["reached"] == "yes", "undisturbed it is shorter still"
    assert spoilt["goals"]["tick"]["reached"] == "open"
    shown = {row["what"]: row["measured"] for row in answer(spoilt, {"a": [1.0]}).table.rows}
    assert shown[GOALS["tick"].what].startswith("?")


def test_report_and_first_screen_are_made_of_the_numbers():
    summary = made_up(loop={"python": {"factor": 12.0, "us_per_tick": 160.0, "tick_p50_us": 20.0},
                            "limit": {"python_over_limit": 5.0, "steps_us": 12.0}},
                      not_run={"peer tsid": {"reason": "it is missing"}, "solver x": {"reason": "y"}})  # fmt: skip
    first = answer(summary, {"exact": np.array([1.0, 2.0])})
    said = " ".join(first.sentences)
    expected = ("20.0 us", "12 times real time", "pink-trimmed, takes 300.0 us", "missed: default")
    assert all(words in said for words in expected)
    assert first.table.rows[0]["reached"].word == "no"
    rows = {row["name"]: row for row in tables(summary)["peers"].rows}
    assert rows["pink-trimmed"]["times_ours"] == 15.0
    assert rows["tsid"]["installed"] == "not run: it is missing"
    assert "x" not in rows
    first_screens.check(report(summary, first, {"seed": 0}).html(), pictures=1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tock = 1", "'tock'.*'ticks'"),
        ("solvers = ['daqp']", "'exact' must be among them"),
        ("solvers = ['exact', 'dapq']", "'dapq'.*'daqp'"),
        ("adapters = ['exakt']", "adapter 'exakt'"),
        ("peers = ['minc']", "'minc'.*'mink'"),
        ("ticks = [", "is not TOML"),
    ],
)
def test_nonsense_in_a_configuration_is_named(text, words, tmp_path, capsys):
    path = tmp_path / "speed.toml"
    path.write_text(text)
    assert speed.main([str(path), "--out", str(tmp_path / "out")]) == 2
    assert re.search(words, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_default_configuration_is_complete_and_quick_is_less():
    config = speed.Config.load(default_config("speed"))
    quick = config.quick()
    assert config.batch == speed.Config().batch == 1_000_000
    assert quick.ticks < config.ticks
    assert quick.solvers == config.solvers


SMALL = """
solvers = ["exact", "proxqp"]
ticks = 100
rounds = 1
batch = 1000
adapters = ["daqp"]
runs = 1
processes = 1
peers = []
[scenario]
duration_s = 0.3
"""


def test_command_leaves_its_four_files(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(runs, "FIRST_RUN", ("-c", ""))
    (tmp_path / "small.toml").write_text(SMALL)
    out = tmp_path / "out"
    assert speed.main([str(tmp_path / "small.toml"), "--out", str(out), "--seed", "3"]) == 0
    assert {path.name for path in out.iterdir()} == {
        "environment.json", "report.html", "rows.parquet", "summary.json",
    }  # fmt: skip
    summary = json.loads((out / "summary.json").read_text())
    assert summary["tick"]["exact"]["tick_p50_us"] > 0.0
    assert summary["tick"]["proxqp"]["tick_p50_us"] > 0.0
    assert summary["goals"]["exact"]["value"] == summary["adapters"]["daqp"]["ratio_of_exact"] > 0.0
    assert summary["goals"]["tick"]["reached"] == summary["goals"]["batch"]["reached"] == "not measured"
    environment = json.loads((out / "environment.json").read_text())
    assert environment["seed"] == 3
    assert environment["config"]["ticks"] == 100
    rows = pq.read_table(out / "rows.parquet").to_pylist()
    assert {row["part"] for row in rows} == {"tick", "tick_parts", "adapters", "loop", "setup"}
    setup = summary["setup"]
    assert setup["first_tick_s"] == pytest.approx(setup["libraries_s"] + setup["model_s"] + setup["start_and_tick_s"])
    (us,) = [row["us_per_tick"] for row in rows if row["part"] == "loop"]  # one round
    limits = summary["loop"]["limit"]
    if "c" in summary["tick"]:
        assert summary["tick"]["c"]["difference_Nm"] == 0.0
        assert limits["python_over_limit"] == pytest.approx(us / limits["limit_us"])
    assert "Goals" in capsys.readouterr().out
