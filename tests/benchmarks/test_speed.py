"""The speed benchmark."""

import json

import numpy as np
import pytest

from benchmarks import speed, timed
from moc_opt.scenario import Scenario, Setup
from moc_opt.solvers import available, create
from moc_opt.study import Failed
from moc_opt.study.timing import load
from tests.problems import random_problem

SHORT = Scenario(judge=False, bound_samples=0, duration_s=0.2)


@pytest.mark.skipif(available().get("daqp", "") is not None, reason="daqp is not installed")
def test_direct_daqp_call_gives_the_adapters_optimum():
    rng = np.random.default_rng(4)
    sequence = [random_problem(rng, structured=False) for _ in range(60)]
    solver = create("daqp")
    by_hand = timed.daqp_by_hand(solver, sequence[0])
    assert timed.disagreement(solver, by_hand, sequence) is None
    for qp in sequence[:20]:
        x, y = by_hand(qp)
        inside = (x > qp.lower + 1e-6) & (x < qp.upper - 1e-6)
        slope = solver.cost_scale * (qp.P @ x + qp.p) + qp.reduced().A.T @ y
        np.testing.assert_allclose(slope[inside], 0.0, atol=1e-8 * np.abs(slope).max() + 1e-9)
    assert "differ by" in timed.disagreement(solver, lambda qp: (np.zeros(7), np.zeros(5)), sequence)


def test_entries_take_turns_by_chunk(monkeypatch):
    monkeypatch.setattr(timed, "CHUNK", 5)
    log, part = [], timed.Part()
    entries = {
        "a": timed.Timed(lambda item: log.append(("a", item)), range(10)),
        "b": timed.Timed(lambda item: log.append(("b", item)), range(100, 112)),
    }
    part.time("tick", entries, rounds=2)
    assert {name: found.shape for name, found in part.times.items()} == {"a": (4, 5), "b": (4, 5)}, "one time per call"
    assert {name: found["times_calls"] for name, found in part.seen.items()} == {"a": 20, "b": 20}
    chunks = [log[i : i + 5] for i in range(0, len(log), 5)]
    assert all(len({name for name, _ in chunk}) == 1 for chunk in chunks)
    # The first round is untimed. The entries alternate in going first.
    assert [chunk[0][0] for chunk in chunks] == ["a", "b", "b", "a"] * 3
    assert [item for name, item in log if name == "a"] == [*range(10)] * 3
    assert [item for name, item in log if name == "b"] == [*range(100, 110)] * 3


def test_figures_include_every_call():
    times = np.full((10, 100), 2.0)
    times[:, :5] = 9.0
    times[3, 50] = 70.0
    part = timed.Part(times={"a": times, "b": np.full((10, 100), 4.0)}, seen={"a": {}})
    found = part.figures("a", "tick")
    assert (found["tick_p50_us"], found["tick_cold_p50_us"], found["tick_max_us"]) == (2.0, 9.0, 70.0)
    assert found["tick_p99_us"] == 9.0, "without the cold calls it would be 2"
    assert part.over("b", "a") == 2.0


def test_recorded_problems_are_those_of_the_run():
    inputs, problems = timed.record(SHORT)
    trace = Setup(SHORT).trace()
    assert len(inputs) == len(problems) == len(trace) == 100
    np.testing.assert_array_equal([qp.row for qp in problems], trace.subproblem)
    np.testing.assert_array_equal([given[2][0] for given in inputs], trace.tip_ref_m)


def test_python_over_limit_is_a_ratio_of_times_of_the_same_run():
    rows = [{"us_per_tick": 40.0 * slow, "steps_us": 10.0 * slow - 1.0} for slow in (1.0, 10.0, 1.0)]
    found = timed.limit(rows, 1.0)
    assert found == {"steps_us": 9.0, "limit_us": 10.0, "python_over_limit": 4.0}
    assert set(timed.limit(rows, None)) == {"steps_us"}


def test_each_period_is_simulated_from_its_recorded_state():
    """`own_steps` simulates a period with the forces of the previous tick, so the result only approximates the run."""
    states, stepped = timed.own_steps(SHORT.change(duration_s=0.4))
    after, n = stepped(), 7
    assert len(states) == 200
    np.testing.assert_allclose(after[:-1, 0], states[1:, 0], rtol=1e-12)
    moved = np.abs(np.diff(states[:, 1 : 1 + n], axis=0))
    assert np.abs(after[:-1, 1 : 1 + n] - states[1:, 1 : 1 + n]).max() < 0.01 * moved.max()


SMALL = """
solvers = ["exact", "proxqp"]
ticks = 100
rounds = 1
batch = 1000
adapters = ["daqp"]
runs = 1
starts = 1
peers = ["tsid"]
scenario.duration_s = 0.2
"""


def test_command_measures_every_part(tiny, capsys, monkeypatch):
    monkeypatch.setattr(speed.peers, "missing", lambda name: "it is missing")
    made = tiny(speed, SMALL)
    summary, rows = made.summary, made.rows
    assert summary["not_run"]["peer tsid"]["reason"] == "it is missing"
    assert min(summary["tick"][name]["tick_p50_us"] for name in ("exact", "proxqp")) > 0.0
    assert summary["goals"]["exact"]["value"] == summary["adapters"][timed.BY_HAND]["ratio_of_exact"] > 0.0
    assert summary["goals"]["tick"]["reached"] == summary["goals"]["batch"]["reached"] == "not measured"
    assert json.loads((made.out / "environment.json").read_text())["load"]["times_calls"] > 0
    assert summary["batch"]["exact"]["batch_two_threads_per_s"] > 0.0
    assert {row["part"] for row in rows} == {"tick", "tick_parts", "adapters", "loop", "setup", None}
    assert [row["controller"] for row in rows if row["error"] == "it is missing"] == ["peer tsid"]
    setup = summary["setup"]
    assert setup["first_tick_s"] == pytest.approx(setup["libraries_s"] + setup["model_s"] + setup["start_and_tick_s"])
    (us,) = [row["us_per_tick"] for row in rows if row["part"] == "loop"]
    if "c" in summary["tick"]:
        assert summary["tick"]["c"]["difference_Nm"] == 0.0
        assert summary["loop"]["limit"]["python_over_limit"] == pytest.approx(us / summary["loop"]["limit"]["limit_us"])
    assert load(speed.timed_rows(summary)) in " ".join(capsys.readouterr().out.split())


def test_goals_of_a_failed_part_are_not_measured(tmp_path, monkeypatch):
    asked = []

    def failing(study, jobs, what, keep):
        asked.extend(jobs)
        assert not keep(object())
        return [Failed("crashed", "the process died")] * len(jobs)

    monkeypatch.setattr(speed.Study, "run", failing)
    assert speed.main(["--quick", "--out", str(tmp_path)]) == 0
    assert "Quick run on less data" in (tmp_path / "report.md").read_text(encoding="utf-8")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {goal["reached"] for goal in summary["goals"].values()} == {"not measured"}
    assert summary["not_run"]["batch"]["reason"] == "crashed: the process died"
    assert [job.group for job in asked if job.alone] == list(dict.fromkeys(job.group for job in asked if job.alone))
    assert all(job.alone for job in asked if job.work is not speed.peers.check)
