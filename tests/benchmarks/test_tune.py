"""The search for parameters: it stays inside its space, its objective says what it should, and it can be run again."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import tune
from benchmarks.paper import STREAM
from moc_opt.control import ControlSettings
from moc_opt.control.presets import TUNED
from moc_opt.robots import load_data
from moc_opt.study.command import CONFIGS
from moc_opt.study.trials import BASELINE, Run, seeds

CONFIG = tune.Config.load(CONFIGS / "tune.toml")
TIP, RCM = tune.ERRORS
GOOD = {
    "gain": 20.0, "worst_gain": 1.0, TIP: 0.06, RCM: 0.12, "torque_rate": 500.0,
    **{f"settled_{name}_high": 0.0 for name in tune.ERRORS}, **{f"travelling_{name}": 0.0 for name in tune.ERRORS},
}  # fmt: skip

TINY = """
tasks = ["circle"]
random = 1
local = 1
finalists = 1
trials = 2
final_trials = 2
[space]
rho_over_c2 = { low = 0.05, high = 0.3, scale = "log" }
K_N2 = { low = 10.0, high = 40.0, scale = "log" }
[hard]
delay_ticks = 2
[scenario]
duration_s = 0.2
judge = false
bound_samples = 0
"""


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_candidates_stay_in_the_space_and_local_ones_lie_near(seed):
    rng = np.random.default_rng(seed)
    first = tune.draw(CONFIG, rng)
    near = [tune.draw(CONFIG, rng, [first]) for _ in range(5)]
    for candidate in (first, *near):
        for name, value in candidate.values.items():
            span = CONFIG.space[name]
            inside = span.low * (1 - 5e-3) <= value <= span.high * (1 + 5e-3)
            assert value in span.choice if span.choice else inside
        ControlSettings(**candidate.control)
    assert np.mean([np.abs(np.subtract(one.places, first.places)).mean() for one in near]) < 0.13


@pytest.mark.parametrize(
    ("name", "missed", "worse"),
    [
        ("gain", 10.0, 18.0), ("worst_gain", -0.5, None), (TIP, 0.12, 0.08), (RCM, 0.25, 0.13),
        (f"settled_{TIP}_high", 6.0, None), (f"settled_{RCM}_high", 6.0, None),
        ("torque_rate", None, 600.0), (f"travelling_{RCM}", None, 10.0),
    ],
)  # fmt: skip
def test_a_missed_goal_costs_more_than_anything_else(name, missed, worse):
    good = tune.objective(GOOD)
    expensive = {**GOOD, "torque_rate": 900.0, **{f"travelling_{error}": 40.0 for error in tune.ERRORS}}
    if missed is not None:
        assert tune.objective({**GOOD, name: missed}) > tune.objective(expensive) > good
    if name.startswith("settled_"):  # a phase that never came is a missed goal
        assert tune.objective({key: value for key, value in GOOD.items() if key != name}) > good + 10.0
    if worse is not None:
        assert good < tune.objective({**GOOD, name: worse}) < good + 1.0


def run(group, controller, rate, mu=0.3, trial=0, **more):
    metrics = {"torque_rate_rms_Nm_per_s": rate, "mu_mean": mu, **dict.fromkeys(tune.ERRORS, 0.05)}
    about = {"group": group, "controller": controller, "trial": f"t{trial}", "ended": "completed"}
    return Run({**about, "whole": True, "error": None, **metrics, **more})


def test_score_reads_the_gain_and_refuses_what_is_not_calm():
    """Gains of 100 and 10 %: of the means it is 19 %, and the mean of both, 55 %, would be another number."""
    candidate = tune.Candidate((), {})
    usual = [
        run("", BASELINE, 500.0, 0.1), run("", tune.SOLVER, 500.0, 0.2),
        run("", BASELINE, 500.0, 0.9, 1), run("", tune.SOLVER, 500.0, 0.99, 1),
    ]  # fmt: skip
    found = tune.score(candidate, [*usual, run("hard", tune.SOLVER, 600.0)])
    assert [found.figures[key] for key in ("gain", "worst_gain")] == pytest.approx([19.0, 10.0])
    assert math.isfinite(found.objective)
    for bad, said in (
        (run("hard", tune.SOLVER, 5000.0), "5000"),
        (run("", tune.SOLVER, 500.0, whole=False, error="the arm ran away"), "ran away"),
        (run("", tune.SOLVER, 500.0, ended="oscillated: joint_7"), "joint_7"),
    ):
        refused = tune.score(candidate, [*usual, bad])
        assert (refused.objective, said in refused.reason) == (math.inf, True)


def test_search_and_experiment_share_no_trial():
    streams = [set(seeds(0, stream, 60)) for stream in (STREAM, tune.SEARCH_STREAM, tune.FINAL_STREAM)]
    assert len(set.union(*streams)) == 180


def test_the_preset_is_a_point_of_the_space():
    """The shipped preset names its command; it must be what that command can draw."""
    gains = load_data("lwr4").gains["tuned"]
    for name, span in CONFIG.space.items():
        value = TUNED["regularization"] / 1e-3 if name == "rho_over_c2" else {**gains, **TUNED}[name]
        assert value in span.choice if span.choice else span.low * 0.99 <= value <= span.high * 1.01
    assert ControlSettings.preset("tuned") == ControlSettings(**TUNED)


def test_the_command_repeats_itself(tiny):
    one, two = (tiny(tune, TINY, pictures=0).summary for _ in range(2))
    assert one == two
    assert set(one["tuned"]["control"]) == {"gains", "K_N2", "regularization"}
