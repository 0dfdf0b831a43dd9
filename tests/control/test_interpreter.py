"""What foreign code changes of the interpreter is put back, in the loop, after a start and after a run."""

import os
import signal
import sys
import threading
from time import sleep

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.reliability.fuzz_solvers import MEDDLING, as_it_is
from moc_opt.control.interpreter import Interpreter
from moc_opt.control.session import start_session
from moc_opt.control.supervisor import ANSWER_EVERY
from moc_opt.scenario import Scenario, run
from moc_opt.solvers.exact.solver import Exact
from tests.problems import random_problem

QUICK = {"duration_s": 0.1, "bound_samples": 0, "judge": False}


def nothing(*arguments):
    return None


class Meddler:
    """The exact solver, which also does something else: when it is started, and at one tick."""

    name = "meddler"

    def __init__(self, at_start=nothing, at_tick=nothing, tick=5):
        self.at_start, self.at_tick, self.tick = at_start, at_tick, tick

    def supports(self, qp):
        return None

    def start(self, qp):
        self.at_start()
        return MeddlingSession(self, Exact().start(qp))


class MeddlingSession:
    def __init__(self, solver, inner):
        self.solver, self.inner, self.asked = solver, inner, 0

    def solve(self, qp):
        self.asked += 1
        answer = self.inner.solve(qp)
        if self.asked == self.solver.tick:
            self.solver.at_tick()
        return answer


@pytest.fixture(scope="module")
def honest():
    return run(Scenario(**QUICK))


def test_the_meddling_shows():
    """What the other tests compare would differ without what they test."""
    for how, meddle in MEDDLING.items():
        with Interpreter():
            before = as_it_is()
            meddle()
            after = as_it_is()
        assert before != after, how


@settings(deadline=None, max_examples=60)
@given(st.lists(st.sampled_from(sorted(MEDDLING)), min_size=1, max_size=6))
def test_everything_is_put_back(what):
    before = as_it_is()
    with Interpreter():
        for how in what:
            MEDDLING[how]()
    assert as_it_is() == before


@pytest.mark.parametrize("how", MEDDLING)
def test_a_start_leaves_the_interpreter_as_it_was(how):
    before = as_it_is()
    start_session(Meddler(at_start=MEDDLING[how]), random_problem(np.random.default_rng(0)))
    assert as_it_is() == before


@pytest.mark.parametrize("how", MEDDLING)
def test_a_run_leaves_the_interpreter_as_it_was(how, honest):
    before = as_it_is()
    trace = run(Scenario(**QUICK), solver=Meddler(at_tick=MEDDLING[how]))
    assert as_it_is() == before
    assert trace.meta["ended"] == "completed"
    if how != "rounding":
        np.testing.assert_array_equal(trace.tau_Nm, honest.tau_Nm)


def test_a_tracer_that_raises_is_a_fault_of_the_solver():
    def raising(frame, event, argument):
        raise RuntimeError("from a tracing function")

    for install in (sys.settrace, sys.setprofile):
        trace = run(Scenario(**QUICK), solver=Meddler(at_tick=lambda install=install: install(raising)))
        assert trace.meta["ended"] == "completed"
        assert sys.gettrace() is not raising
        assert sys.getprofile() is None


def test_a_solver_cannot_keep_ctrl_c_from_a_long_run():
    """One that ignores it at the fifth tick: a second of answers later it ends the run again."""

    def interrupt(tick):
        if tick == ANSWER_EVERY + 10:
            os.kill(os.getpid(), signal.SIGINT)

    scenario = Scenario(**{**QUICK, "duration_s": 0.002 * (ANSWER_EVERY + 100)})
    with pytest.raises(KeyboardInterrupt):
        run(scenario, interrupt, solver=Meddler(at_tick=MEDDLING["ctrl-c"]))


def test_an_alarm_of_the_caller_stays_as_it_is():
    rung = []
    handler = signal.signal(signal.SIGALRM, lambda *_: rung.append(1))
    try:
        with Interpreter():
            signal.setitimer(signal.ITIMER_REAL, 1e-3)
            with Interpreter():
                while not rung:
                    signal.pause()
            assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)  # it is over, and not set anew
        signal.setitimer(signal.ITIMER_REAL, 1000.0)
        with Interpreter():
            pass
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 0.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)
    assert len(rung) == 1


@pytest.mark.parametrize("changed_to", [0.0, 5000.0])
def test_an_alarm_of_the_caller_that_foreign_code_changed_rings_when_it_was_to_ring(changed_to):
    try:
        signal.setitimer(signal.ITIMER_REAL, 1000.0, 7.0)
        with Interpreter():
            signal.setitimer(signal.ITIMER_REAL, changed_to)
            sleep(0.02)
        left, interval = signal.getitimer(signal.ITIMER_REAL)
        assert 0.0 < left <= 1000.0 - 0.01
        assert interval == 7.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def test_another_thread_puts_back_its_own_alone():
    """A loop in a thread must not undo what the main thread does to the process meanwhile."""
    found = {}

    def work():
        here = Interpreter()
        np.seterr(all="raise")
        changed.set()
        moved.wait()
        here.restore()
        found.update(np.geterr(), folder=os.getcwd(), stdout=sys.stdout)

    changed, moved, folder, stdout = threading.Event(), threading.Event(), os.getcwd(), sys.stdout
    thread = threading.Thread(target=work)
    thread.start()
    changed.wait()
    try:
        os.chdir("/")
        sys.stdout = sys.__stderr__
        moved.set()
        thread.join()
    finally:
        os.chdir(folder)
        sys.stdout = stdout
    assert (found.pop("folder"), found.pop("stdout")) == ("/", sys.__stderr__)
    assert set(found.values()) != {"raise"}


def test_a_controller_may_be_made_in_one_thread_and_run_in_another():
    """As on the live page: only the main thread may set handlers of signals."""
    made, raised = Interpreter(), []
    handler = signal.getsignal(signal.SIGTERM)

    def work():
        try:
            made.calm()
            made.answer_signals()
            made.restore()
        except ValueError as error:  # what signal.signal raises outside of the main thread
            raised.append(error)

    signal.signal(signal.SIGTERM, nothing)
    try:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        assert raised == []
        assert signal.getsignal(signal.SIGTERM) is nothing
    finally:
        signal.signal(signal.SIGTERM, handler)
