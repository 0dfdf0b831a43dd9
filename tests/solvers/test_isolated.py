"""If a solver fails in its own process, the run goes on."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from moc_opt.errors import MocOptError, SolverError
from moc_opt.qp.problem import NullSpaceQP, fields
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.solvers.isolated import Isolated, ProcessSettings, Unanswered
from tests.isolated_solvers import Misbehaving
from tests.problems import random_problem

QUICK = {"bound_samples": 0, "judge": False, "duration_s": 0.1}


@pytest.fixture
def qp():
    return random_problem(np.random.default_rng(0))


def started(qp, act="", at=2, folder="", budget_us=np.inf, waits=True, **settings):
    """Start a session whose process counts as hung after a minute without an answer."""
    process = ProcessSettings(**{"hang_s": 60.0, **settings})
    return Isolated(Misbehaving(act, at, str(folder)), process, budget_us, waits).start(qp)


def fault_of(session, qp):
    try:
        session.solve(qp)
    except Unanswered as missing:
        return missing.kind, missing.text
    raise AssertionError("the solver answered")


def pid(session):
    return session._process._process.pid


def until(said):
    end = time.monotonic() + 60.0
    while not said():
        assert time.monotonic() < end
        time.sleep(0.01)


def is_gone(number):
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.parametrize("solver", ["exact", "rnn-printed"])  # rnn-printed observes the velocity
def test_trace_does_not_depend_on_isolation(solver):
    inside, isolated = (
        run(Scenario(solver={"name": solver, "isolation": way, "process": {"hang_s": 60.0}}, **QUICK))
        for way in ("none", "process")
    )
    assert set(inside.columns) == set(isolated.columns)
    for name in inside.columns.keys() - {"tick_us", "solve_us"}:
        np.testing.assert_array_equal(inside.columns[name], isolated.columns[name], err_msg=name)
    assert isolated.meta["faults"] == inside.meta["faults"] == {}
    assert "restarts" not in isolated.meta


@pytest.mark.parametrize(("act", "kind", "reason"), [
    ("hang", "lost", "no answer for 0.5 s"), ("exit", "lost", "ended with status 3"),
    ("fork and exit", "lost", "ended with status 3"), ("crash", "lost", "killed by SIGSEGV"),
    ("close everything", "lost", "closed its end"), ("eat", "lost", "its memory was full: raise [solver.process]"),
    ("raise", "raised", "by zero (isolated_solvers.py, line "), ("quit", "raised", "SystemExit: enough"),
])  # fmt: skip
def test_failure_costs_one_answer(qp, act, kind, reason):
    limits = {"hang": {"hang_s": 0.5}, "eat": {"memory_MB": 500.0}}
    session = started(qp, act, **limits.get(act, {}))
    assert session.solve(qp).iterations == 1
    first, (found, text) = pid(session), fault_of(session, qp)
    assert found == kind
    assert reason in text
    assert is_gone(first) == (kind == "lost")
    if act == "hang":
        assert session.solve(qp).iterations == 1  # the new session's first answer
    assert [(tick, why in text) for tick, why in session.restarts] == ([(1, True)] if kind == "lost" else [])


def test_solver_is_given_up_if_its_process_is_lost_too_often(qp):
    session = started(qp, "exit", at=1, most_restarts=1)
    texts = [fault_of(session, qp)[1] for _ in range(4)]
    assert ["status 3" in text for text in texts] == [True, True, False, False]
    assert "given up" in texts[-1]
    assert len(session.restarts) == 2


def test_late_answer_is_used_until_it_is_too_old(qp, tmp_path):
    def numbered(number):
        row = np.array(qp.row)
        fields(row).weights[0] = number
        return NullSpaceQP.from_row(row)

    own, old = (started(qp, "gated", folder=tmp_path, budget_us=2e5, answer_age_ticks=age) for age in (0, 1))
    for session in (own, old):
        session.observe(np.arange(7.0))
        assert fault_of(session, numbered(1))[0] == "late"
    (tmp_path / "1").touch()
    answer = old.solve(numbered(2))  # the answer to problem 1, because problem 2 has none yet
    assert answer.iterations == 1
    np.testing.assert_array_equal(answer.x, np.arange(7.0))
    np.testing.assert_array_equal(answer.y, qp.b)
    assert fault_of(own, numbered(2))[0] == "late"
    assert fault_of(old, numbered(3))[0] == "late"  # its newest answer is two ticks old
    for number in "234":
        (tmp_path / number).touch()
    assert [session.solve(numbered(4)).iterations for session in (own, old)] == [4, 4]
    assert own.restarts == old.restarts == []


def test_in_real_time_no_tick_waits_for_the_new_process(qp):
    session = started(qp, "exit", waits=False)
    session.solve(qp)
    assert "status 3" in fault_of(session, qp)[1]
    assert fault_of(session, qp) == ("lost", "a new process of the solver is being started")
    until(lambda: session._process.started(0.0))
    assert session.solve(qp).iterations == 1


def test_child_processes_end_with_the_session(qp, tmp_path):
    session, file = started(qp, "child and hang", at=1, folder=tmp_path, budget_us=1000.0), tmp_path / "pid"
    assert fault_of(session, qp)[0] == "late"
    until(lambda: file.exists() and file.read_text())
    numbers = [int(file.read_text()), pid(session)]
    del session
    until(lambda: all(map(is_gone, numbers)))


def test_hanging_solver_process_ends_after_its_parent_was_killed():
    """The process ends by itself after 2 `hang_s` + 1 s."""
    code = (
        "import numpy as np; from tests.problems import random_problem; from moc_opt.solvers.isolated import *; "
        "from tests.isolated_solvers import Misbehaving; qp = random_problem(np.random.default_rng(0)); "
        "s = Isolated(Misbehaving('hang', 1), ProcessSettings(hang_s=0.2)).start(qp); w = s._process; "
        "print(w._process.pid, flush=True); w.ask(1, qp, None, 0.2); import os; os.kill(os.getpid(), 9)"
    )
    said = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=False)
    assert said.returncode == -signal.SIGKILL
    until(lambda: is_gone(int(said.stdout)))


@pytest.mark.parametrize(("act", "settings", "text"), [
    ("refuse", {}, "solver 'misbehaving' in a process of its own: .* not this one"),
    ("fail at the start", {}, "in a process of its own: RuntimeError: no licence"),
    ("", {"start_s": 0.01}, "no answer for 0.01 s"),
    (lambda: None, {}, "cannot run in a process of its own: .*isolation = 'none'"),
])  # fmt: skip
def test_solver_that_cannot_start_is_refused(qp, act, settings, text):
    with pytest.raises(SolverError, match=text):
        started(qp, act, **settings)


def test_process_enforces_the_budget_unless_times_are_replayed():
    scenario = Scenario(solver={"isolation": "process"}, control={"supervisor": {"budget_us": 700.0}}, **QUICK)
    controller = Setup(scenario).controller()
    assert (controller.solver.budget_us, controller.settings.supervisor.budget_us) == (700.0, None)
    replayed = Setup(scenario.change(solver={"replay_us": [100.0, 900.0]})).controller()
    assert (replayed.solver.budget_us, replayed.settings.supervisor.budget_us) == (float("inf"), 700.0)
    real = Setup(Scenario(solver={"isolation": "process"}, **QUICK), realtime=True).controller().solver
    assert (real.waits, real.budget_us) == (False, 1000.0)  # half a period
    with pytest.raises(MocOptError, match="isolation"):
        Scenario(solver={"isolation": "process"}, control={"supervisor": {"late": "iterate"}})
