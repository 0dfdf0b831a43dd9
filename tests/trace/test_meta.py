"""A trace's meta: what pages and tables read is of its kind, or the trace is refused by the entry's name."""


import numpy as np
import pytest

from moc_opt.errors import TraceError
from moc_opt.scenario import Scenario, run
from moc_opt.trace.meta import FORMS, Ending, check_entry
from moc_opt.trace.trace import Trace

SOUND = {
    "ended": "stopped: the tip", "robot": "lwr4", "mu_bound_method": "scanned",
    "ticks": 3, "ticks_planned": 9, "period_s": 0.002, "stopped_at_s": 1,
    "faults": {"raised": {"count": 2, "first_at_s": 0.0, "first": "ValueError"}},
    "restarts": [{"at_s": 0.1, "reason": "it hung"}],
    "warnings": [{"of": "the RCM error", "unit": "m", "level": 6e-3, "first_s": 0.1, "largest": 8e-3}],
    "scenario": {"robot": {"name": "lwr4", "tool_length_m": None, "tool_mass_kg": 0.3}, "seed": 1},
    "best_courses": {"absent": ""},
}  # fmt: skip
WRONG = {
    "ended": 3, "robot": None, "mu_bound_method": [], "ticks": 3.5, "ticks_planned": True,
    "period_s": "0.002", "stopped_at_s": [1.0], "faults": {"raised": {"count": 2, "first": "ValueError"}},
    "restarts": {"at_s": 0.1, "reason": "it hung"}, "warnings": [{**SOUND["warnings"][0], "level": None}],
    "scenario": {"robot": ["lwr4"]}, "best_courses": {"absent": "", "end": {"mu": 0.1}},
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_an_entry_of_another_kind_is_refused_by_its_name(name):
    check_entry(name, SOUND[name])
    Trace({"mu": np.ones(2)}, {name: SOUND[name]})
    for give in (lambda meta: Trace({}, meta), lambda meta: Trace({}).with_meta(**meta)):
        with pytest.raises(TraceError, match=name):
            give({name: WRONG[name]})


def test_an_entry_that_the_package_does_not_know_may_hold_anything():
    assert Trace({}, {"my_own": [{"a": None}]}).meta["my_own"] == [{"a": None}]


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario(), Scenario(control={"law": "dcac"}), Scenario(faults={"solver": "raise", "solver_share": 0.5}),
        Scenario(robot={"tool_length_m": 0.25}, best_courses=True),
        Scenario(guard={"rcm_error_m": 1e-9, "rcm_warning_m": 1e-9}),
    ],
)  # fmt: skip
def test_what_runs_leave_is_of_its_kind(scenario):
    meta = run(scenario.change(duration_s=0.3, bound_samples=2)).meta
    assert set(meta) & set(FORMS) >= {"ended", "robot", "ticks", "ticks_planned", "period_s", "scenario"}
    for name, value in meta.items():
        check_entry(name, value)


@pytest.mark.parametrize(("text", "ending", "whole"), [
    ("completed", Ending.COMPLETED, True), ("oscillated: joint_7 at 47 Hz, 0.51 rad/s", Ending.OSCILLATED, True),
    ("stopped: the tip is 12 mm off (t = 0.100 s)", Ending.STOPPED, False), ("failed", Ending.FAILED, False),
    ("ran away at t = 0.250 s", Ending.RAN_AWAY, False), ("ScenarioError: seed = -1", Ending.FAILED, False),
    ("", Ending.FAILED, False),
])  # fmt: skip
def test_the_first_word_decides(text, ending, whole):
    assert Ending.of(text) is ending
    assert Ending.of(text).whole is whole
