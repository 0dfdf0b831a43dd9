"""Solvers in processes of their own: the same run where they behave, and a fallback tick where they do not."""

import contextlib
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from moc_opt.control.isolated import Isolated, ProcessSettings
from moc_opt.control.supervisor import Fault, Unanswered
from moc_opt.errors import ControlError, ScenarioError
from moc_opt.qp.problem import NullSpaceQP, fields
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.scenario.exported import export_scenario
from moc_opt.trace.metrics import summarize
from tests import isolated_solvers as bad
from tests.broken_solvers import install
from tests.problems import random_problem

QUICK = {"bound_samples": 0, "duration_s": 0.4}
CLOCKS = ("tick_us", "solve_us")


def until(said):
    """Wait for something that another process does."""
    end = time.monotonic() + 60.0
    while not said():
        assert time.monotonic() < end
        time.sleep(0.01)


def is_gone(pid):
    """Whether there is no such process, or one that only waits to be collected."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.fixture
def qp():
    return random_problem(np.random.default_rng(0))


def numbered(qp, number):
    row = np.array(qp.row)
    fields(row).weights[0] = number
    return NullSpaceQP.from_row(row)


def started(solver, qp, budget_us=None, waits=True, **settings):
    """A session; nothing on a busy machine counts as hung unless the test says so."""
    return Isolated(solver, ProcessSettings(**{"hang_s": 60.0, **settings}), budget_us, waits).start(qp)


@pytest.mark.parametrize("solver", ["exact", "osqp", "rnn-printed"])
def test_a_solver_that_behaves_gives_the_same_trace(solver):
    scenario = Scenario(solver={"name": solver}, **QUICK)  # rnn-printed observes the velocity
    inside, isolated = run(scenario), run(scenario.change(solver={"isolation": "process", "process": {"hang_s": 60.0}}))
    assert set(inside.columns) == set(isolated.columns)
    for name, column in inside.columns.items():
        if name not in CLOCKS:
            np.testing.assert_array_equal(column, isolated.columns[name], err_msg=name)
    assert isolated.meta["faults"] == inside.meta["faults"] == {}
    assert "restarts" not in isolated.meta


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        (bad.hang, "no answer for 0.5 s"),
        (bad.ring_and_hang, "no answer for 0.5 s"),
        (bad.keep_the_lock, "no answer for 0.5 s"),
        (bad.stop, "no answer for 0.5 s"),
        (bad.exit_3, "ended with status 3"),
        (bad.fork_and_exit_3, "ended with status 3"),
        (bad.scribble_and_hang, "wrote over the memory"),
        (bad.crash, "killed by SIGSEGV"),
        (bad.close_everything, "closed its end"),
    ],
)
def test_a_process_that_is_lost_costs_one_answer_and_is_replaced(qp, act, reason):
    session = started(bad.Misbehaving(act), qp)
    assert session.solve(qp).iterations == 1
    first, patient = session._workers[0].pid, session._settings
    if "no answer" in reason:  # for this one answer alone: any other may take long on a busy machine
        session._settings = ProcessSettings(hang_s=0.5)
    with pytest.raises(Unanswered, match=reason) as lost:
        session.solve(qp)
    session._settings = patient
    assert lost.value.fault is Fault.LOST
    assert is_gone(first)
    assert session.solve(qp).iterations == 1  # of a new session
    (restart,) = session.restarts
    assert restart.tick == 1
    assert restart.reason in lost.value.text


def test_a_kill_from_outside_costs_one_answer(qp):
    session = started(bad.Misbehaving(), qp)
    os.kill(session._workers[0].pid, signal.SIGKILL)
    with pytest.raises(Unanswered, match="killed by SIGKILL"):
        session.solve(qp)
    assert session.solve(qp).iterations == 1


@pytest.mark.parametrize(
    ("act", "fault", "text"),
    [
        (bad.system_exit, Fault.RAISED, "SystemExit: enough"),
        (bad.interrupt, Fault.RAISED, "KeyboardInterrupt"),
        (bad.huge, Fault.MALFORMED, r"x has shape \(30000000,\)"),
        (bad.unpicklable, Fault.MALFORMED, "x is a function"),
    ],
)
def test_an_answer_that_is_none_costs_no_process(qp, act, fault, text):
    session = started(bad.Misbehaving(act), qp)
    assert session.solve(qp).iterations == 1
    with pytest.raises(Unanswered, match=text) as wrong:
        session.solve(qp)
    assert wrong.value.fault is fault
    assert session.solve(qp).iterations == 3  # of the same session
    assert session.restarts == []


def test_a_claim_of_no_form_is_counted_in_one_way(qp):
    ways = [
        run(Scenario(solver={"isolation": way}, duration_s=0.02, bound_samples=0), solver=bad.Misbehaving(bad.huge, 3))
        for way in ("none", "process")
    ]
    inside, isolated = (summarize(trace) for trace in ways)
    for name in ("claimed_solved", "silently_wrong", "verified_solved"):
        assert inside[name] == isolated[name]
    assert inside["silently_wrong"] == 1.0  # it says "solved" of an x that is none
    for trace in ways:
        assert trace.fault[2] == "malformed"
        np.testing.assert_array_equal(trace.status, ways[0].status)


def test_a_process_that_grows_is_replaced_before_the_machine_is_full(qp):
    session = started(bad.Leaking(), qp, memory_MB=800.0)
    counts = []
    while not session.restarts:
        counts.append(session.solve(qp).iterations)  # every answer is there, the last one too
        assert len(counts) < 10
    assert counts == list(range(1, len(counts) + 1))
    assert "MB of memory, and 800 MB are allowed" in session.restarts[0].reason
    assert session.solve(qp).iterations == 1


@pytest.mark.parametrize(
    ("solver", "settings", "reason"),
    [
        (bad.Misbehaving(bad.hang, 1), {"hang_s": 0.5}, "it gave no answer for 0.5 s"),
        (bad.Leaking(), {"memory_MB": 800.0}, "MB of memory, and 800 MB are allowed"),
    ],
)
def test_a_process_that_is_only_ever_late_is_replaced_where_it_hangs_or_grows(qp, solver, settings, reason):
    session, end = started(solver, qp, 1000.0, **settings), time.monotonic() + 60.0
    while not session.restarts:
        assert time.monotonic() < end
        with contextlib.suppress(Unanswered):  # now and then one is in time
            session.solve(qp)
    assert reason in session.restarts[0].reason


def test_a_solver_that_is_always_lost_is_given_up(qp):
    session = started(bad.Misbehaving(bad.exit_3, at=1), qp, most_restarts=1)
    texts = []
    for _ in range(4):
        with pytest.raises(Unanswered) as lost:
            session.solve(qp)
        texts.append(lost.value.text)
    assert ["status 3" in text for text in texts] == [True, True, False, False]
    assert "given up: the solver's process was lost 2 times" in texts[-1]
    assert len(session.restarts) == 2


def test_an_answer_that_is_late_may_stand_for_the_next_one(qp, tmp_path):
    fresh = {name: started(bad.Gated(str(tmp_path)), qp, 1000.0, answer_age_ticks=age)
             for name, age in (("own", 0), ("old", 1))}  # fmt: skip
    for session in fresh.values():
        session.observe(np.arange(7.0))
        with pytest.raises(Unanswered) as late:
            session.solve(numbered(qp, 1))
        assert late.value.fault is Fault.LATE
    (tmp_path / "1").touch()
    for session in fresh.values():
        worker = session._workers[0]
        until(lambda worker=worker: worker.exchange.answered == worker.posted)
    found = fresh["old"].solve(numbered(qp, 2))  # problem 2 has no answer yet
    assert found.iterations == 1
    np.testing.assert_array_equal(found.x, np.arange(7.0))
    np.testing.assert_array_equal(found.y, qp.b)
    with pytest.raises(Unanswered) as late:
        fresh["own"].solve(numbered(qp, 2))
    assert late.value.fault is Fault.LATE
    with pytest.raises(Unanswered):  # two ticks old by now
        fresh["old"].solve(numbered(qp, 3))
    assert all(session.restarts == [] for session in fresh.values())


def test_against_a_wall_clock_a_spare_takes_over(qp):
    session = started(bad.Misbehaving(bad.exit_3), qp, waits=False)
    spare = session._workers[1]
    until(lambda: not spare.start(0.0))
    session.solve(qp)
    with pytest.raises(Unanswered, match="status 3"):
        session.solve(qp)
    assert session.solve(qp).iterations == 1
    assert session._workers[0] is spare
    os.kill(session._workers[1].pid, signal.SIGSTOP)  # the next spare never gets ready
    with pytest.raises(Unanswered, match="status 3"):
        session.solve(qp)
    with pytest.raises(Unanswered, match="is being started") as waiting:
        session.solve(qp)
    assert waiting.value.fault is Fault.LOST


def test_what_the_solver_started_ends_with_it(qp, tmp_path):
    file = tmp_path / "pid"
    session = started(bad.Parent(str(file)), qp, 1000.0)
    with pytest.raises(Unanswered):
        session.solve(qp)
    until(lambda: file.exists() and file.read_text())
    pids = [int(file.read_text()), session._workers[0].pid]
    del session
    until(lambda: all(map(is_gone, pids)))


@pytest.mark.parametrize(
    ("solver", "text"),
    [
        (bad.Refusing("refuse"), "solver 'refusing' cannot run in this controller: not this one"),
        (bad.Refusing("raise"), "cannot run in this controller: RuntimeError: no licence"),
        (bad.Refusing("exit"), "in a process of its own: it ended with status 5"),
        (bad.Locked(), "cannot run in a process of its own: TypeError: cannot pickle .*isolation = 'none'"),
    ],
)
def test_a_solver_that_cannot_run_there_is_refused_before_anything_moves(qp, solver, text):
    with pytest.raises(ControlError, match=text):
        started(solver, qp)


def test_another_system_is_named(monkeypatch):
    monkeypatch.delattr(os, "memfd_create")
    with pytest.raises(ControlError, match="needs Linux"):
        Isolated(bad.Misbehaving())


def test_a_run_survives_a_plug_in_that_hangs(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(install(tmp_path)))
    isolated = {"isolation": "process", "process": {"hang_s": 5.0}}
    told = {"name": "hangs", "settings": {"at": 120}, **isolated}
    trace = run(Scenario(solver=told, **QUICK))
    assert trace.meta["ended"] == "completed"
    np.testing.assert_array_equal(np.flatnonzero(trace.fault == "lost"), [120])
    assert trace.meta["faults"]["lost"]["count"] == 1
    assert trace.meta["restarts"] == [{"at_s": 0.24, "reason": "it gave no answer for 5 s"}]
    held, before = (trace.columns["applied_x_rad_per_s"][k] for k in (120, 119))
    np.testing.assert_array_equal(held, before)
    assert trace.columns["verified"].sum() == len(trace) - 1


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"control": {"backend": "c"}}, r"take \[control\] backend = 'python'"),
        ({"control": {"supervisor": {"late": "iterate"}}}, "take 'hold' or 'zero'"),
        ({"solver": {"process": {"hang_s": 0.0}}}, r"hang_s = 0\.0"),
    ],
)
def test_what_cannot_be_isolated_is_refused(change, text):
    solver = {"isolation": "process", **change.pop("solver", {})}
    with pytest.raises((ScenarioError, ControlError), match=text):
        Scenario(solver=solver, **change)


def test_exported_c_refuses_isolation(tmp_path):
    with pytest.raises(ScenarioError, match=r"isolation = 'process'.*leave it out"):
        export_scenario(Scenario(solver={"isolation": "process"}, **QUICK), tmp_path)


def test_a_budget_is_kept_by_one_of_the_two():
    scenario = Scenario(solver={"isolation": "process"}, control={"supervisor": {"budget_us": 700.0}}, **QUICK)
    controller = Setup(scenario).controller()
    assert controller.solver.budget_us == 700.0
    assert controller.settings.supervisor.budget_us is None
    replayed = Setup(scenario.change(solver={"replay_us": [100.0, 900.0]})).controller()
    assert replayed.solver.budget_us == float("inf")
    assert replayed.settings.supervisor.budget_us == 700.0


def test_against_a_wall_clock_no_tick_waits_for_long():
    scenario = Scenario(solver={"isolation": "process"}, plant={"period_s": 0.004, "substeps": 4}, **QUICK)
    simulated, real = (Setup(scenario, realtime=realtime).controller().solver for realtime in (False, True))
    assert (simulated.waits, simulated.budget_us) == (True, float("inf"))
    assert (real.waits, real.budget_us) == (False, 2000.0)
    assert Setup(scenario.change(solver={"isolation": "none"}), realtime=True).controller().solver.name == "exact"


def test_a_process_cannot_cut_off_the_memory_that_it_shares(qp):
    """Without its seal the file could be made shorter, and the next look into it would end this process by SIGBUS."""
    session = started(bad.Misbehaving(bad.shrink), qp)
    session.solve(qp)
    with pytest.raises(Unanswered, match="PermissionError"):
        session.solve(qp)
    assert session.solve(qp).status is not None
    assert session.restarts == []


def test_what_a_process_writes_over_the_exchange_is_only_numbers_and_text(qp):
    """Numbers of answers, statuses, lengths that nothing has: an answer like any other, or none; never an exception."""
    session = started(bad.Misbehaving(bad.scribble), qp, hang_s=1.0)
    said = []
    for _ in range(6):
        try:
            said.append(str(session.solve(qp).x.shape))
        except Unanswered as error:
            said.append(error.text)
    assert len(said) == 6
    assert "".join(said).isprintable()
