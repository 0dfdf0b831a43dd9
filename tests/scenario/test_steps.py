"""Whole periods in one compiled call against the single step, which Python takes part by part: the same to the bit."""

import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from moc_opt.control.controller import Controller
from moc_opt.errors import ControlError
from moc_opt.scenario import Scenario, Setup, steps
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim.loop import RunAway

BLIND = {
    "motion": False, "tip_error_m": 1.0, "tip_error_s": 10.0, "rcm_error_m": None, "trocar_force_N": None,
    "jump_rad": 1e4, "speed_factor": 1e4, "rcm_warning_m": None, "trocar_force_warning_N": None,
}  # fmt: skip
CASES = {
    "sound": ({}, "completed"),
    "a warning at most ticks": ({"guard": {"rcm_warning_m": 1e-5}}, "completed"),
    "torques cut at most ticks": ({"guard": {"torque_rate_Nm_per_s": 60.0}}, "completed"),
    "some measurements refused": (
        {"guard": {**BLIND, "jump_rad": 1e-6, "patience_ticks": 50}, "plant": {"encoder_noise_rad": 1.5e-3}},
        "completed",
    ),
    "stopped by what is measured": ({"guard": {"residual_torque": 0.001}}, "stopped: the measured motion"),
    "stopped by the trocar's force": (
        {"guard": {"trocar_force_warning_N": None, "trocar_force_N": 0.3}}, "stopped: the trocar's force",
    ),
    "stopped by the tip": ({"guard": {"tip_error_m": 2e-5, "tip_error_s": 0.002}}, "stopped: the tip has been"),
    "a long delay": ({"plant": {"delay_ticks": 3}}, "completed"),
    "elastic joints": ({"plant": {"joint_stiffness_Nm_per_rad": 1e4, "substeps": 10}}, "completed"),
    "no noise": ({"plant": {"preset": "nominal"}}, "completed"),
    "no third level": ({"control": {"law": "dcac"}}, "completed"),
    "the arm runs away": ({"plant": {"trocar_damping_Ns_per_m": 1e4}, "guard": BLIND}, "ran away"),
}  # fmt: skip
"""What is changed -> how the run ends."""


def compiled_run(robot="lwr4", seed=4, duration_s=0.6, watch=None, to=None, block=5000, backend="c", **tables):
    control = {"backend": backend, **tables.pop("control", {})}
    scenario = Scenario(robot={"name": robot}, seed=seed, duration_s=duration_s, judge=False, bound_samples=0,
                        control=control, **tables)  # fmt: skip
    try:
        return Setup(scenario).trace(watch, to, block)
    except RunAway as error:
        return error.trace


@pytest.fixture
def taken(monkeypatch):
    """How many periods each compiled call took, and what it had begun when it ended."""
    found, step = [], steps.CompiledSteps.__call__

    def counted(self, block, most, applied):
        done = step(self, block, most, applied)
        found.append((done.periods, done.begun))
        return done

    monkeypatch.setattr(steps.CompiledSteps, "__call__", counted)
    return found


def single_steps(monkeypatch, **tables):
    with monkeypatch.context() as patch:
        patch.setattr(steps, "compiled_steps", lambda *parts: None)
        return compiled_run(**tables)


def assert_same(one, other):
    told = [{k: v for k, v in trace.meta.items() if k != "replans"} for trace in (one, other)]
    assert told[0] == told[1]
    assert one.columns.keys() == other.columns.keys()
    for name in one.columns.keys() - {"tick_us", "solve_us"}:
        np.testing.assert_array_equal(one.columns[name], other.columns[name], err_msg=name)


@pytest.mark.parametrize("backend", ["c", "python"])
@pytest.mark.parametrize("case", CASES)
def test_compiled_periods_are_single_steps_to_the_bit(case, backend, taken, monkeypatch):
    tables, end = CASES[case]
    trace = compiled_run(backend=backend, **tables)
    assert trace.meta["ended"].startswith(end)
    assert_same(trace, single_steps(monkeypatch, backend=backend, **tables))
    periods, begun = sum(done for done, _ in taken), [begun for _, begun in taken]
    assert periods > 5
    if end == "completed" and case not in ("a warning at most ticks", "some measurements refused"):
        assert periods >= len(trace) - 1
    found_in = {
        "a warning at most ticks": "before", "some measurements refused": "before",
        "stopped by the trocar's force": "before", "stopped by the tip": "after", "the arm runs away": "after",
        "stopped by what is measured": "after",
    }  # fmt: skip
    assert case not in found_in or any(getattr(at, found_in[case]) is not None for at in begun)
    assert np.isfinite(trace.tick_us).all()
    assert (trace.tick_us > 0.0).all()


@pytest.mark.parametrize("robot", ["gen3", "iiwa14", "panda", "xarm7"])
def test_so_they_are_on_other_arms(robot, taken, monkeypatch):
    tables = {"robot": robot, "seed": 7, "guard": {"torque_rate_Nm_per_s": 500.0}}
    trace = compiled_run(**tables)
    assert_same(trace, single_steps(monkeypatch, **tables))
    assert sum(done for done, _ in taken) >= len(trace) - 1


@pytest.mark.parametrize(("cause", "end"), [("push", "v = "), ("trocar", "the arm has not moved")])
def test_a_plant_that_cannot_go_on_says_so_in_the_same_words(cause, end, taken, monkeypatch):
    def run():
        setup = Setup(Scenario(control={"backend": "c"}, judge=False, bound_samples=0, duration_s=0.2))
        at = setup.trocar.at
        if cause == "trocar":
            lost = SimpleNamespace(at=lambda t: (np.where(t[:, None] < 0.1, at(t)[0], np.nan), at(t)[1]))
            monkeypatch.setattr(setup, "trocar", lost)
        with pytest.raises(RunAway, match=end) as caught:
            setup.trace(lambda k: setup.plant.push("link_4", [1e12, 0.0, 0.0]) if (cause, k) == ("push", 50) else None)
        return caught.value

    whole = run()
    assert taken[-1][1].moved is not None
    monkeypatch.setattr(steps, "compiled_steps", lambda *parts: None)
    part_by_part = run()
    assert str(whole) == str(part_by_part)
    assert len(whole.trace) == 51
    assert_same(whole.trace, part_by_part.trace)


def test_a_watch_is_called_before_every_tick_and_can_end_the_run(taken):
    ticks = []
    trace = compiled_run(watch=ticks.append)
    assert ticks == list(range(len(trace)))
    assert {done for done, _ in taken} <= {0, 1}
    assert_same(trace, compiled_run())

    def stops(tick):
        if tick == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compiled_run(watch=stops)


def test_blocks_that_go_to_a_file_are_the_same_rows(tmp_path):
    trace, whole = compiled_run(to=tmp_path / "run.parquet", block=77), compiled_run()
    assert len(trace) == len(whole)
    for name in ("q_rad", "tau_Nm", "tip_ref_m", "x_rad_per_s", "limited"):
        np.testing.assert_array_equal(trace.columns[name], whole.columns[name], err_msg=name)


@pytest.mark.parametrize("backend", ["c", "python"])
def test_faults_around_the_arm_are_stepped_in_python(backend, taken):
    assert compiled_run(duration_s=0.05, backend=backend, faults={"bump_N": 20.0}).meta["ended"] == "completed"
    assert taken == []


PYTHON = {
    "another solver": {"solver": {"name": "daqp"}},
    "answers that are refused": {"faults": {"solver": "nan", "solver_share": 0.3}},
    "a solver that hangs": {"faults": {"solver": "hang", "solver_share": 0.1}, "duration_s": 0.2},
    "a process of its own": {"solver": {"isolation": "process"}, "duration_s": 0.2},
    "the scaled climb": {"control": {"climb": "scaled"}},
    "a course": {"control": {"third_level": "receding"}, "duration_s": 0.3},
    "cut torques and another arm": {"robot": "panda", "guard": {"torque_rate_Nm_per_s": 60.0}},
}  # fmt: skip


@pytest.mark.parametrize("case", PYTHON)
def test_whatever_the_controller_in_python_does_its_compiled_periods_are_single_steps(case, taken, monkeypatch):
    trace = compiled_run(backend="python", **PYTHON[case])
    assert sum(done for done, _ in taken) >= len(trace) - 1
    assert_same(trace, single_steps(monkeypatch, backend="python", **PYTHON[case]))


def test_columns_are_written_outside_of_the_time_of_a_tick(monkeypatch):
    note = ControllerAdapter.note

    def slow(self, row, columns):
        time.sleep(0.02)
        note(self, row, columns)

    monkeypatch.setattr(ControllerAdapter, "note", slow)
    trace = compiled_run(backend="python", duration_s=0.1)
    assert 0.0 < np.median(trace.tick_us) < 10_000.0


@pytest.mark.parametrize("error", [RuntimeError("lost"), KeyboardInterrupt(), ControlError("no answer")])
def test_an_error_of_a_tick_in_python_is_raised_once_where_it_was(error, monkeypatch, taken):
    tick, asked = Controller.tick, []

    def failing(self, *given):
        asked.append(1)
        if len(asked) == 10:
            raise error
        return tick(self, *given)

    monkeypatch.setattr(Controller, "tick", failing)
    if isinstance(error, ControlError):
        trace = compiled_run(backend="python", duration_s=0.2)
        assert trace.meta["ended"].startswith("stopped: the controller failed: no answer")
    else:
        with pytest.raises(type(error)) as caught:
            compiled_run(backend="python", duration_s=0.2)
        assert caught.value is error
    assert len(asked) == 10
    assert taken[0][0] == 8, "the first tick was a rehearsal"


@pytest.mark.parametrize("error", [RuntimeError("lost"), KeyboardInterrupt()])
def test_an_error_before_the_first_line_of_a_tick_in_python_is_raised(error, monkeypatch, taken):
    """Ctrl-C arrives while compiled code runs; Python raises it as it enters the function that ctypes calls."""

    class Ref:
        def __init__(self, what):
            self.what, self.calls = what, 0

        def __call__(self):
            self.calls += 1
            if self.calls == 10:
                raise error
            return self.what

    monkeypatch.setattr("moc_opt.scenario.python_tick.weakref", SimpleNamespace(ref=Ref))
    hook = sys.unraisablehook
    with pytest.raises(type(error)):
        compiled_run(backend="python", duration_s=0.2)
    assert [done for done, _ in taken] == [9]
    assert sys.unraisablehook is hook
