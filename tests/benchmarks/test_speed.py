"""The speed benchmark: what it compares does the same work, its ratios are of times side by side, goals are judged."""

import json

import numpy as np
import pytest

from benchmarks import speed, timed
from moc_opt.figures.notation import Doubtful
from moc_opt.scenario import Scenario, Setup
from moc_opt.solvers import available, create
from moc_opt.study import Failed
from moc_opt.study.timing import UNDISTURBED, Disturbance
from tests.problems import unstructured_problems

SHORT = Scenario(judge=False, bound_samples=0, duration_s=0.2)


@pytest.mark.skipif(available().get("daqp", "") is not None, reason="daqp is not installed")
def test_by_hand_the_answer_is_the_adapter_s_and_optimal():
    sequence = unstructured_problems(7, 60, np.random.default_rng(4))
    solver = create("daqp")
    by_hand = timed.daqp_by_hand(solver, sequence[0])
    assert timed.disagreement(solver, by_hand, sequence) is None
    for qp in sequence[:20]:
        x, y = by_hand(qp)
        inside = (x > qp.lower + 1e-6) & (x < qp.upper - 1e-6)
        slope = solver.cost_scale * (qp.P @ x + qp.p) + qp.reduced().A.T @ y
        np.testing.assert_allclose(slope[inside], 0.0, atol=1e-8 * np.abs(slope).max() + 1e-9)
    assert "differ by" in timed.disagreement(solver, lambda qp: (np.zeros(7), np.zeros(5)), sequence)


def test_what_was_recorded_is_what_the_run_asked():
    inputs, problems = timed.record(SHORT)
    trace = Setup(SHORT).trace()
    assert len(inputs) == len(problems) == len(trace) == 100
    np.testing.assert_array_equal([qp.row for qp in problems], trace.subproblem)
    np.testing.assert_array_equal([given[2][0] for given in inputs], trace.tip_ref_m)


def test_ratios_are_those_of_the_same_round():
    """One slow round in three changes no ratio: it slows both sides of it."""
    rows = [{"us_per_tick": 40.0 * slow, "steps_us": 10.0 * slow - 1.0} for slow in (1.0, 10.0, 1.0)]
    found = timed.limit(rows, 1.0, UNDISTURBED)
    assert found == {"steps_us": 9.0, "limit_us": 10.0, "python_over_limit": 4.0}
    assert set(timed.limit(rows, None, UNDISTURBED)) == {"steps_us"}
    spoilt = timed.limit(rows, 1.0, Disturbance(calls=10, switches=9, cpu_s=1.0, wall_s=1.0))
    assert all(isinstance(value, Doubtful) for value in spoilt.values())


def test_the_limit_steps_through_the_states_of_the_run():
    """From each state one control period leads to the next; the forces of its steps differ by one step's motion."""
    states, stepped = timed.own_steps(SHORT.change(duration_s=0.4))
    after, n = stepped(), 7
    assert len(states) == 200
    np.testing.assert_allclose(after[:-1, 0], states[1:, 0], rtol=1e-12)
    moved = np.abs(np.diff(states[:, 1 : 1 + n], axis=0))
    assert np.abs(after[:-1, 1 : 1 + n] - states[1:, 1 : 1 + n]).max() < 0.01 * moved.max()


def made_up(**changes):
    """A summary with a number for everything that the report and the goals ask for."""
    times = {"tick_p50_us": 20.0, "tick_p99_us": 30.0, "tick_p99_9_us": 90.0}
    parts = {
        "tick": {"exact": times, "c": {**times, "tick_p50_us": 3.0}},
        "tick_parts": {"solver": times},
        "peers": {"pink-trimmed": {**times, "level": "velocity", "tip_error_max_mm": 0.1, "tick_p50_us": 300.0,
                                   "times_ours": 15.0}},
        "batch": {"exact": {"batch": 1e6, "batch_one_thread_per_s": 2.1e6, "batch_two_threads_per_s": 4.2e6}},
        "adapters": {"exact": {"adapter_p50_us": 1.0},
                     timed.BY_HAND: {"adapter_p50_us": 10.0, "ratio_of_exact": 0.1}},
        "loop": {"python": {"factor": 40.0, "us_per_tick": 29.0, **times}},
        "setup": {"first_tick_s": 0.4, "first_run_s": 8.0, "libraries_s": 0.3, "model_s": 0.1, "start_and_tick_s": 0.0},
        **changes,
    }  # fmt: skip
    rows = [{"part": "loop", "us_per_tick": 29.0, "steps_us": 7.0}]
    return speed.summed_up(timed.Part(parts, rows), {"peer tsid": "it is missing"})


def test_goals_are_reached_by_a_summary_that_reaches_them():
    found = made_up()["goals"]
    assert {key: goal["reached"] for key, goal in found.items()} == dict.fromkeys(speed.GOALS, "yes")
    assert (found["batch"]["value"], found["limit"]["value"]) == (4.2, 2.9)
    assert found["exact"]["made_of"] == "1.00 and 10.00 us"
    assert "pink-trimmed, takes 300.0 us" in speed.report(made_up(), {}).answer[1]


def test_goals_that_are_missed_not_measured_or_in_doubt_say_so():
    fewer = {"batch": 250_000, "batch_one_thread_per_s": 2e6, "batch_two_threads_per_s": 4e6}
    by_hand = {"exact": {"adapter_p50_us": 1.0}, timed.BY_HAND: {"adapter_p50_us": 5.0, "ratio_of_exact": 0.2}}
    setup = {"first_tick_s": 0.6, "libraries_s": 0.5, "model_s": 0.1, "start_and_tick_s": 0.0}
    worse = made_up(adapters=by_hand, peers={}, batch={"exact": fewer}, loop={}, setup=setup)["goals"]
    assert {name: (goal["reached"], goal["value"] is None) for name, goal in worse.items()} == {
        **dict.fromkeys(speed.GOALS, ("not measured", True)), "first_torque": ("no", False), "exact": ("no", False),
        "c_tick": ("yes", False),
    }  # fmt: skip
    times = {"tick_p50_us": Doubtful(3.0), "tick_p99_us": Doubtful(30.0), "tick_p99_9_us": Doubtful(4000.0)}
    peer = {"tick_p50_us": 300.0, "times_ours": Doubtful(15.0)}
    spoilt = made_up(tick={"exact": times, "c": times}, peers={"pink-trimmed": peer})
    assert spoilt["goals"]["c_tick"]["reached"] == "yes", "undisturbed it is shorter still"
    assert spoilt["goals"]["tick"]["reached"] == "open"
    shown = {row["what"]: row["measured"] for row in speed.report(spoilt, {}).table.rows}
    assert shown[speed.GOALS["tick"].what].startswith("?")


SMALL = """
solvers = ["exact", "proxqp"]
ticks = 100
rounds = 1
batch = 1000
adapters = ["daqp"]
runs = 1
starts = 1
peers = ["tsid"]
[scenario]
duration_s = 0.2
"""


def test_command_leaves_its_files(tiny, capsys, monkeypatch):
    monkeypatch.setattr(speed.peers, "missing", lambda name: "it is missing")
    left = tiny(speed, SMALL, pictures=1)
    summary, rows = left.summary, left.rows
    assert summary["not_run"]["peer tsid"]["reason"] == "it is missing"
    assert min(summary["tick"][name]["tick_p50_us"] for name in ("exact", "proxqp")) > 0.0
    assert summary["goals"]["exact"]["value"] == summary["adapters"][timed.BY_HAND]["ratio_of_exact"] > 0.0
    assert summary["goals"]["tick"]["reached"] == summary["goals"]["batch"]["reached"] == "not measured"
    assert json.loads((left.out / "environment.json").read_text())["load"]["calls"] > 0
    assert summary["batch"]["exact"]["batch_two_threads_per_s"] > 0.0
    assert {row["part"] for row in rows} == {"tick", "tick_parts", "adapters", "loop", "setup", None}
    assert [row["controller"] for row in rows if row["error"] == "it is missing"] == ["peer tsid"]
    setup = summary["setup"]
    assert setup["first_tick_s"] == pytest.approx(setup["libraries_s"] + setup["model_s"] + setup["start_and_tick_s"])
    (us,) = [row["us_per_tick"] for row in rows if row["part"] == "loop"]  # one round
    if "c" in summary["tick"]:
        assert summary["tick"]["c"]["difference_Nm"] == 0.0
        assert summary["loop"]["limit"]["python_over_limit"] == pytest.approx(us / summary["loop"]["limit"]["limit_us"])
    assert "of a core" in capsys.readouterr().out


def test_a_part_that_fails_is_not_measured_and_nothing_is_kept(tmp_path, monkeypatch):
    asked = []

    def failing(study, jobs, what, keep):
        asked.extend(jobs)
        assert not keep(object())
        return [Failed("crashed", "the process died")] * len(jobs)

    monkeypatch.setattr(speed.Study, "run", failing)
    assert speed.main(["--quick", "--out", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {goal["reached"] for goal in summary["goals"].values()} == {"not measured"}
    assert summary["not_run"]["batch"]["reason"] == "crashed: the process died"
    assert [job.group for job in asked if job.alone] == list(dict.fromkeys(job.group for job in asked if job.alone))
    assert all(job.alone for job in asked if job.work is not speed.peers.check)
