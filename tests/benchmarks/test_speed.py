"""The speed benchmark: what it compares is comparable, the peers do the job they are timed at, the goals are judged."""

import dataclasses
import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.util import find_spec

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks import baselines as peers
from benchmarks import speed
from benchmarks.baselines import check
from benchmarks.baselines.base import TipGradient, wrist_reference
from benchmarks.common import output
from benchmarks.latency import goals, limit
from benchmarks.latency import setup as speed_setup
from benchmarks.latency import solve as speed_solve
from benchmarks.latency.bare import BARE
from benchmarks.latency.config import Config
from benchmarks.latency.goals import GOALS, goal_verdicts
from benchmarks.latency.report import answer, headline, report, tables
from moc_opt.errors import ScenarioError, UnknownNameError
from moc_opt.qp.problem import compute_residuals
from moc_opt.scenario import Scenario
from moc_opt.solvers import available, create
from moc_opt.solvers.exact.solver import Exact
from tests import first_screens

INSTALLED = [name for name in BARE if available().get(name, "") is None]


@pytest.fixture(scope="module")
def sequence():
    """Subproblems of slowly changing random arms without structure."""
    return speed_solve.random_problems(7, 120, np.random.default_rng(4))


@pytest.fixture(scope="module")
def work(robot):
    return check.job(robot)


# --- the libraries by hand ---


@pytest.mark.parametrize("name", INSTALLED)
def test_by_hand_the_answer_is_the_adapter_s_and_optimal(name, sequence):
    solver = create(name)
    session, bare = solver.start(sequence[0]), BARE[name](solver, sequence[0])
    answers = [bare(qp)[0] for qp in sequence]
    for qp, x in zip(sequence, answers, strict=True):
        np.testing.assert_allclose(x, session.solve(qp).x, atol=1e-4)
    found = compute_residuals(np.array([qp.row for qp in sequence]), np.array(answers))
    assert (found.primal < 1e-6).all()
    assert (found.relative < 1e-3).all()


@pytest.mark.parametrize("name", INSTALLED)
def test_by_hand_multipliers_are_read(name, sequence):
    """P x + p + A^T y vanishes inside the box, in the library's own scale and sign."""
    solver, qp = create(name), sequence[0]
    x, y = BARE[name](solver, qp)(qp)
    A = qp.reduced().A
    inside = (x > qp.lower + 1e-6) & (x < qp.upper - 1e-6)
    scale = solver.cost_scale
    ends = [np.abs((scale * (qp.P @ x + qp.p) + sign * (A.T @ y))[inside]).max() for sign in (1.0, -1.0)]
    assert np.shape(y) == (5,)
    assert min(ends) < 1e-4 * max(ends)


@pytest.mark.parametrize("name", INSTALLED)
def test_by_hand_the_parts_are_the_whole(name, sequence):
    solver = create(name)
    whole, part = BARE[name](solver, sequence[0]), BARE[name](solver, sequence[0])
    for qp in sequence[:20]:
        part.load(qp)
        np.testing.assert_allclose(whole(qp)[0], part.solve(qp)[0], atol=1e-4)


def test_what_does_other_work_is_not_compared(sequence, monkeypatch):
    class Lazy:
        def __init__(self, settings, qp):
            self.x = create("exact").start(qp).solve(qp).x

        def __call__(self, qp):
            return self.x, np.zeros(5)

    assert speed_solve.disagreement(INSTALLED[0], create(INSTALLED[0]), sequence) is None
    monkeypatch.setitem(BARE, INSTALLED[0], Lazy)
    assert "differ by" in speed_solve.disagreement(INSTALLED[0], create(INSTALLED[0]), sequence)


# --- the solver alone ---


@pytest.mark.parametrize("n", [6, 7, 9])
def test_random_problems_are_feasible_and_rigid(n):
    for qp in speed_solve.random_problems(n, 20, np.random.default_rng(n)):
        tool = np.linalg.svd(qp.J_tip - qp.J_wrist)[0][:, 2]
        np.testing.assert_allclose(tool @ (qp.J_tip - qp.J_wrist), 0.0, atol=1e-12)
        assert abs(tool @ (qp.v_tip - qp.v_wrist)) < 1e-12
        assert np.linalg.matrix_rank(qp.A, tol=1e-9) == min(5, n)
        assert Exact().start(qp).solve(qp).status.label == "solved"


def test_residuals_are_those_of_the_answers(sequence):
    found = speed_solve.residuals(sequence)
    assert found["solves"] == found["solved"] == len(sequence)
    assert found["primal_max"] < 1e-12
    assert found["natural_max"] < 1e-12
    answers = [Exact().start(qp).solve(qp) for qp in sequence]
    judged = compute_residuals(
        np.array([qp.row for qp in sequence]),
        np.array([answer.x for answer in answers]),
        np.array([answer.y for answer in answers]),
    )
    assert found["natural_max"] == judged.natural.max()


def test_kernel_and_batch_take_time(sequence):
    rows = np.array([qp.row for qp in sequence])
    assert 0.01 < speed_solve.kernel_us(rows, seconds=0.02) < 1e4
    found = speed_solve.batch(rows, 1000)
    assert (found["batch"], found["batch_threads"]) == (1000, os.cpu_count())
    assert found["batch_one_thread_per_s"] == pytest.approx(1000 / found["batch_one_thread_s"])
    assert found["batch_all_cores_per_s"] == pytest.approx(1000 / found["batch_all_cores_s"])


def test_a_batch_is_solved_whole_by_one_thread_and_by_all(sequence, monkeypatch):
    asked = []

    class Counting(Exact):
        def solve_batch(self, rows, threads=None):
            asked.append((len(rows), threads))
            return super().solve_batch(rows, threads)

    monkeypatch.setattr(speed_solve, "Exact", Counting)
    speed_solve.batch(np.array([qp.row for qp in sequence[:7]]), 2500)
    assert asked == [(1000, None), (2500, 1), (2500, 1), (2500, os.cpu_count()), (2500, os.cpu_count())]


# --- peers ---


def test_gradient_for_peers_is_the_model_s(robot, regular_poses):
    gradient = TipGradient(robot)
    for q in regular_poses(5):
        np.testing.assert_allclose(gradient(q), robot.state(q).grad_mu, atol=1e-14)


def test_wrist_reference_puts_the_shaft_through_the_trocar(robot):
    state = robot.state(robot.data.q_home)
    tip_ref = np.array([state.tip + 0.01, [0.02, -0.01, 0.03], np.zeros(3)])
    trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
    wrist, rate = wrist_reference(tip_ref, trocar, state.tool_span)
    assert check.shaft_distance(tip_ref[0], wrist, trocar[0]) < 1e-12
    assert np.linalg.norm(wrist - tip_ref[0]) == pytest.approx(state.tool_span)
    later, _ = wrist_reference(
        tip_ref + np.array([1e-6 * tip_ref[1], np.zeros(3), np.zeros(3)]), trocar, state.tool_span
    )
    np.testing.assert_allclose((later - wrist) / 1e-6, rate, atol=1e-5)


@pytest.mark.parametrize("name", list(peers.PEERS))
def test_a_peer_that_is_listed_does_the_job(name, robot, work):
    reason = peers.missing(name)
    if reason is not None:
        pytest.skip(reason)
    peer = peers.create(name, robot, check.PERIOD_S)
    poses, given = check.perform(peer, robot, work)
    assert check.verdict(poses, robot, work).failure is None
    assert len(given) == len(poses) == len(work.tip_refs)


class Puppet:
    """A velocity-level controller of five lines, to be made wrong in one respect."""

    level = "velocity"

    def __init__(self, robot, *, tip=1.0, shaft=1.0, climb=30.0):
        self.robot, self.parts, self.climb = robot, np.repeat([tip, shaft], 3), climb

    def tick(self, q, v, tip_ref, trocar):
        state = self.robot.state(q)
        wrist, rate = wrist_reference(tip_ref, trocar, state.tool_span)
        error = np.r_[tip_ref[0] - state.tip, wrist - state.wrist]
        wanted = self.parts * (np.r_[tip_ref[1], rate] + 100.0 * error)
        pinv = np.linalg.pinv(state.A, rcond=1e-9)
        return pinv @ wanted + (np.eye(7) - pinv @ state.A) @ (self.climb * state.grad_mu)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({}, None),
        ({"tip": -1.0}, "tip is"),
        ({"tip": 0.1}, "tip is"),
        ({"shaft": 0.02}, "shaft is|tip is"),
        ({"climb": 0.0}, "manipulability rose"),
        ({"climb": -30.0}, "manipulability rose"),
    ],
)
def test_who_does_not_do_the_job_is_found_out(wrong, words, robot, work):
    poses, _ = check.perform(Puppet(robot, **wrong), robot, work)
    failure = check.verdict(poses, robot, work).failure
    assert failure is None if words is None else any(word in failure for word in words.split("|"))


def test_a_torque_peer_moves_the_ideal_arm(robot, work):
    class Hold:
        level = "torque"

        def tick(self, q, v, tip_ref, trocar):
            return robot.state(q, v).h

    short = work._replace(tip_refs=work.tip_refs[:50], trocars=work.trocars[:50])
    poses, given = check.perform(Hold(), robot, short)
    np.testing.assert_allclose(poses, np.tile(work.q_start, (50, 1)), atol=1e-12)
    assert "tip is" in check.verdict(*check.perform(Hold(), robot, work)[:1], robot, work).failure
    assert len(given) == 50


def test_what_is_not_finite_has_not_done_the_job(robot, work):
    assert check.verdict(np.full((500, 7), np.nan), robot, work).failure is not None


def test_unknown_peers_and_missing_packages(robot, monkeypatch):
    with pytest.raises(UnknownNameError, match=r"peer 'tsit'.*'tsid'"):
        peers.create("tsit", robot, 0.002)
    entry = peers.Library("benchmarks.baselines.nobody", "Nobody", "a_package_that_nobody_has", "pip install it")
    monkeypatch.setitem(peers.PEERS, "nobody", entry)
    assert peers.missing("nobody") == "package 'a_package_that_nobody_has' is not installed: pip install it"
    monkeypatch.setitem(peers.PEERS, "crash", entry._replace(package="numpy"))
    assert "crash" in peers.missing("crash")  # the other process knows no such peer: its words are the reason


def test_a_process_that_dies_is_a_reason(monkeypatch):
    if find_spec("mink") is None:
        pytest.skip("mink is not installed")
    dead = subprocess.CompletedProcess([], -6, "", "")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: dead)
    assert peers.missing("mink") == "its process ended with status -6"


# --- goals, report, command ---


def made_up(**changes):
    """A summary with a number for everything that the report and the goals ask for."""
    times = {"tick_p50_us": 20.0, "tick_p99_us": 30.0, "tick_p99_9_us": 90.0}
    solve = {
        "solve_p50_us": 1.4, "solve_p99_us": 2.0, "solve_p99_9_us": 3.0, "kernel_us": 0.5, "batch": 1_000_000,
        "batch_threads": 3, "batch_one_thread_s": 4.0, "batch_all_cores_s": 2.0,
        "primal_max": 1e-15, "natural_max": 1e-15, "loss_max": 1e-14,
    }  # fmt: skip
    summary = {
        "tick": {"exact": times, "c": {**times, "tick_p50_us": 3.0}},
        "tick_parts": {"solver": times},
        "peers": {"rival": {**times, "level": "torque", "installed": "hand",
                             "tip_error_max_mm": 0.1, "tick_p50_us": 100.0}},
        "exact": {"recorded": solve, "n = 7": solve},
        "adapters": {"daqp": {"ratio": 1.04, "by_hand_p50_us": 5.0}, "osqp": {"ratio": 1.01}},
        "beyond_the_library": {"daqp": {"beyond_us": 1.0}},
        "loop": {
            "python": {"factor": 40.0, **times}, "c": {"factor": 70.0, **times}, "two processes": {"speed_up": 1.9},
            "limit": {"judged_over_loop": 1.2, "python_over_limit": 3.9, "c_over_limit": 1.9},
        },
        "setup": {"moc_opt": {"import_s": 0.01, "first_tick_s": 1.0}},
        "embedded": {},
        "clock": {"cost": {"p50_us": 0.04}},
        "not_run": {},
        **changes,
    }  # fmt: skip
    summary["goals"] = goal_verdicts(summary)
    return summary


def test_goals_are_reached_by_a_summary_that_reaches_them():
    assert {found["reached"] for found in made_up()["goals"].values()} == {"yes"}
    assert set(made_up()["goals"]) == set(GOALS)


def test_ratios_are_those_of_the_same_round():
    """One slow round in three changes no ratio: it slows both sides of it."""
    rows = [
        {"name": name, "us_per_tick": slow * us}
        for slow in (1.0, 10.0, 1.0) for name, us in (("python", 40.0), ("c", 20.0), ("judged", 50.0))
    ]  # fmt: skip
    found = limit.ratios(rows, [9.0, 99.0, 9.0], [7.0, 70.0, 7.0], 1.0)
    assert found == {
        "steps_us": 9.0, "steps_alone_us": 7.0, "limit_us": 10.0, "judged_over_loop": 1.25, "python_over_limit": 4.0,
        "c_over_limit": 2.0,
    }  # fmt: skip
    without = limit.ratios(rows, [9.0, 99.0, 9.0], [7.0, 70.0, 7.0], None)
    assert set(without) == {"steps_us", "steps_alone_us", "judged_over_loop"}


def test_the_limit_steps_through_the_states_of_the_run():
    """From each state one control period leads to the next; the forces of its steps differ by one step's motion."""
    steps = limit.Steps(Scenario(judge=False, bound_samples=0, duration_s=1.0))
    after, n = steps.stepped(), 7
    assert len(steps.states) == 500
    np.testing.assert_allclose(after[:-1, 0], steps.states[1:, 0], rtol=1e-12)
    moved = np.abs(np.diff(steps.states[:, 1 : 1 + n], axis=0))
    assert np.abs(after[:-1, 1 : 1 + n] - steps.states[1:, 1 : 1 + n]).max() < 0.01 * moved.max()
    assert steps.us() > 0.0
    assert steps.alone_us() > 0.0


def test_a_million_is_a_million():
    """A smaller batch is no measurement of it, and the goal names how many threads shared the work."""
    goals = made_up()["goals"]
    assert goals["exact_batch"]["value"] == 4.0
    assert goals["exact_batch"]["what"].endswith("in one call, one thread")
    assert goals["exact_batch_all"]["what"] == "exact: the same, 3 threads"
    fewer = {**made_up()["exact"]["recorded"], "batch": 250_000}
    assert made_up(exact={"recorded": fewer})["goals"]["exact_batch"]["reached"] == "not measured"
    config = Config.load(output.default_config("speed"))
    assert config.exact.batch == Config().exact.batch == 1_000_000


def test_a_peer_that_is_not_installed_is_listed_with_the_reason():
    told = made_up(not_run={"peer tsid": {"reason": "package 'tsid' is not installed"}, "solver x": {"reason": "y"}})
    rows = {row["name"]: row.get("installed") for row in tables(told)["peers"].rows}
    assert rows["rival"] == "hand"
    assert rows["tsid"] == "not run: package 'tsid' is not installed"
    assert "x" not in rows


def test_the_extra_installs_what_is_said_to_be_installed_by_it():
    extras = tomllib.loads((peers.ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["peers"]
    given = {re.split(r"[<>=]", name)[0] for name in extras}
    for entry in peers.PEERS.values():
        assert entry.extra == (entry.install.removeprefix("pip install ") in given)


def test_goals_that_are_missed_or_not_measured_say_so():
    worse = made_up(
        adapters={"daqp": {"ratio": 1.01, "by_hand_p50_us": 5.0}, "osqp": {"ratio": 1.06}}, peers={},
        loop={"python": {"factor": 29.0, "tick_p50_us": 20.0, "tick_p99_9_us": 101.0}}, setup={},
    )["goals"]  # fmt: skip
    assert worse["adapters"] == {**worse["adapters"], "value": 1.06, "reached": "no"}
    assert worse["loop"]["reached"] == worse["loop_tick_p99_9"]["reached"] == "no"
    missing = {name for name, found in worse.items() if found["reached"] == "not measured"}
    limits = {"judged", "limit_python", "limit_c"}
    assert missing == {"peers", "peers_c", "import", "first_tick", "two_processes", "c_loop", *limits}
    assert all(worse[name]["value"] is None for name in missing)


def test_report_and_headline_are_made_of_the_numbers(tmp_path):
    summary = made_up(loop={"python": {"factor": 12.0, "tick_p50_us": 20.0}})
    said = headline(summary)
    assert "20.0 us" in said
    assert "12 times real time" in said
    assert "rival, takes 100.0 us" in said
    assert "not reached: " in said.lower()
    rival = next(row for row in tables(summary)["peers"].rows if row["name"] == "rival")
    assert rival["times_ours"] == pytest.approx(5.0)
    assert rival["times_c"] == pytest.approx(100.0 / 3.0)
    first = answer(summary, {"exact": np.array([1.0, 2.0])})
    page = report(summary, first, {"seed": 0}).html()
    first_screens.check(page)
    assert "rival" in page
    assert "12.0" in page
    assert page.index("Not reached") < page.index('class="section"')
    assert {row["reached"].word for row in first.table.rows} == {"yes", "no", "open"}


def test_times_of_new_processes_are_those_they_tell(monkeypatch):
    monkeypatch.setattr(speed_setup, "IMPORT", "print('{\"import_s\": 0.25}')")
    monkeypatch.setattr(speed_setup, "FIRST_TICK", "print('{\"first_tick_s\": 1.5}')")
    steps = []
    found, rows = speed_setup.setup_times(2, steps.append)
    assert found["moc_opt"]["import_s"] == 0.25
    assert found["moc_opt"]["first_tick_s"] == 1.5
    assert found["moc_opt"]["import_process_s"] > 0.0
    assert len(rows) == 4
    assert len(steps) == 6
    assert speed_setup.setup_times(0, steps.append) == ({}, [])


def test_first_tick_program_runs():
    done = subprocess.run(
        [sys.executable, "-c", speed_setup.FIRST_TICK], capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)
    parts = found["libraries_s"] + found["model_s"] + found["start_and_tick_s"]
    assert found["first_tick_s"] == pytest.approx(parts)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tock = 1", "'tock'.*'tick'"),
        ("[tick]\nsolvers = ['daqp']", "'exact' must be among them"),
        ("[tick]\nsolvers = ['exact', 'dapq']", "'dapq'.*'daqp'"),
        ("[adapters]\nnames = ['exakt']", "adapter 'exakt'"),
        ("[peers]\nnames = ['minc']", "'minc'.*'mink'"),
        ("[loop]\nmemory_s = [2.0, 1.0]", "shorter length first"),
        ("[tick", "is not TOML"),
    ],
)
def test_nonsense_in_a_configuration_is_named(text, words, tmp_path, capsys):
    path = tmp_path / "speed.toml"
    path.write_text(text)
    assert speed.main([str(path), "--out", str(tmp_path / "out")]) == 2
    assert re.search(words, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_default_configuration_is_complete_and_quick_is_less():
    config = Config.load(output.default_config("speed"))
    quick = config.quick()
    assert quick.tick.ticks < config.tick.ticks
    assert quick.tick.solvers == config.tick.solvers
    assert quick.loop.duration_s < config.loop.duration_s
    with pytest.raises(ScenarioError, match="no such file"):
        Config.load(output.default_config("nobody"))


SMALL = """
[tick]
solvers = ["exact", "proxqp"]
ticks = 100
rounds = 1
[exact]
joints = [6]
problems = 100
batch = 1000
[adapters]
names = ["proxqp"]
rounds = 1
[loop]
duration_s = 0.3
runs = 1
two_process_rounds = 0
memory_s = [0.1, 0.2]
[setup]
processes = 0
[peers]
names = []
"""


def test_command_leaves_its_four_files(tmp_path, capsys):
    (tmp_path / "small.toml").write_text(SMALL)
    out = tmp_path / "out"
    assert speed.main([str(tmp_path / "small.toml"), "--out", str(out), "--seed", "3"]) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "environment.json", "report.html", "rows.parquet", "summary.json",
    ]  # fmt: skip
    summary = json.loads((out / "summary.json").read_text())
    assert summary["tick"]["exact"]["tick_p50_us"] > 0.0
    assert summary["tick"]["proxqp"]["tick_p50_us"] > 0.0
    assert summary["exact"]["n = 6"]["natural_max"] < 1e-12
    assert summary["adapters"]["proxqp"]["ratio"] > 0.0
    assert summary["loop"]["python"]["factor"] > 0.0
    assert summary["loop"]["memory"]["growth_bytes_per_tick"] < 100.0
    assert summary["goals"]["tick_p50"]["value"] == summary["tick"]["exact"]["tick_p50_us"]
    assert summary["goals"]["peers"]["reached"] == "not measured"
    environment = json.loads((out / "environment.json").read_text())
    assert environment["seed"] == 3
    assert environment["config"]["tick"]["ticks"] == 100
    rows = pq.read_table(out / "rows.parquet").to_pylist()
    assert {"tick", "tick_parts", "exact", "adapters", "loop"} <= {row["part"] for row in rows}
    us = {row["name"]: row["us_per_tick"] for row in rows if row["part"] == "loop"}  # one round
    limits = summary["loop"]["limit"]
    assert limits["judged_over_loop"] == pytest.approx(us["judged"] / us["python"])
    if "c" in summary["loop"]:
        for name in ("python", "c"):
            assert limits[f"{name}_over_limit"] == pytest.approx(us[name] / limits["limit_us"])
    assert "Goals" in capsys.readouterr().out


def test_settings_of_the_adapters_are_dataclasses():
    assert all(dataclasses.is_dataclass(create(name)) for name in INSTALLED)


def test_a_missed_goal_has_a_reason_from_the_same_numbers_where_they_have_one():
    tick = {"exact": {"tick_p50_us": 20.4, "tick_p99_9_us": 201.0}, "c": {"tick_p50_us": 3.0, "tick_p99_9_us": 62.0},
            "rnn": {"tick_p50_us": 22.0, "tick_p99_9_us": 151.0}}  # fmt: skip
    adapters = {"a": {"ratio": 1.0, "adapter_p50_us": 5.0, "by_hand_p50_us": 5.0},
                "b": {"ratio": 1.2, "adapter_p50_us": 12.0, "by_hand_p50_us": 10.0}}  # fmt: skip
    summary = {"tick": tick, "adapters": adapters}
    assert "the best solver here has 151 us, the tick in C 62" in goals.reason("tick_p99_9", summary)
    assert goals.reason("adapters", summary) == "b: 12.0 us, by hand 10.0"
    assert goals.reason("loop", summary) == ""
    assert goals.reason("import", summary) == ""
    assert set(goals.WHY) <= set(goals.GOALS)
