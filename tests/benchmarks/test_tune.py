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
from moc_opt.study.results import Results
from moc_opt.study.trials import BASELINE, Run, seeds

GOOD = {
    "gain": 20.0, "worst_gain": 1.0, "tip_error_model_mean_mm": 0.06, "rcm_error_model_mean_mm": 0.12,
    "torque_rate": 500.0,
    **{f"settled_{name}_high": 0.0 for name in tune.ERRORS}, **{f"travelling_{name}": 0.0 for name in tune.ERRORS},
}  # fmt: skip

TINY = """
seed = 3
tasks = ["circle"]
random = 2
local = 1
finalists = 2
trials = 2
final_trials = 2
[space]
rho_over_c2 = { low = 0.05, high = 0.3, log = true }
K_N2 = { low = 10.0, high = 40.0, log = true }
[hard]
delay_ticks = 2
[scenario]
duration_s = 0.8
judge = false
bound_samples = 0
"""


@pytest.fixture(scope="module")
def config():
    return tune.Config.load(CONFIGS / "tune.toml")


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_candidates_stay_in_the_space_and_make_settings(seed):
    config = tune.Config.load(CONFIGS / "tune.toml")
    rng = np.random.default_rng(seed)
    first = tune.draw(config, rng)
    for candidate in (first, tune.draw(config, rng, [first])):
        for name, value in candidate.values.items():
            span = config.space[name]
            if span.choices is None:
                assert span.low * (1 - 5e-3) <= value <= span.high * (1 + 5e-3)
            else:
                assert value in span.choices
        ControlSettings(**candidate.control)


def test_local_candidates_lie_near(config):
    rng = np.random.default_rng(0)
    first = tune.draw(config, rng)
    near = [tune.draw(config, rng, [first]) for _ in range(50)]
    far = [tune.draw(config, rng) for _ in range(50)]

    def spread(drawn):
        return np.mean([np.abs(np.subtract(c.places, first.places)).mean() for c in drawn])

    assert spread(near) < 0.12 < spread(far)


def test_rho_follows_the_ratio():
    candidate = tune.Candidate((0.5,), {"rho_over_c2": 0.05})
    assert candidate.control == {"gains": "default", "regularization": 5e-5}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gain", 10.0),
        ("worst_gain", -0.5),
        ("tip_error_model_mean_mm", 0.12),
        ("rcm_error_model_mean_mm", 0.25),
        *((f"settled_{error}_high", 6.0) for error in tune.ERRORS),
    ],
)
def test_a_missed_goal_costs_more_than_anything_else(name, value):
    missed = tune.objective({**GOOD, name: value})
    expensive = {**GOOD, "torque_rate": 900.0, **{f"travelling_{error}": 40.0 for error in tune.ERRORS}}
    assert missed > tune.objective(GOOD)
    assert missed > tune.objective(expensive)


@pytest.mark.parametrize(
    ("name", "worse"),
    [
        ("torque_rate", 600.0),
        ("gain", 18.0),
        ("tip_error_model_mean_mm", 0.08),
        ("travelling_rcm_error_model_mean_mm", 10.0),
    ],
)
def test_costs_rise_where_it_gets_worse(name, worse):
    assert tune.objective({**GOOD, name: worse}) > tune.objective(GOOD)


def test_a_settled_phase_that_never_came_is_a_missed_goal():
    never = {name: value for name, value in GOOD.items() if not name.startswith("settled_")}
    assert tune.objective(never) > tune.objective(GOOD) + 10.0


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
    assert found.figures["gain"] == pytest.approx(19.0)
    assert found.figures["worst_gain"] == pytest.approx(10.0)
    assert math.isfinite(found.objective)
    for bad, said in (
        (run("hard", tune.SOLVER, 5000.0), "5000"),
        (run("", tune.SOLVER, 500.0, whole=False, error="the arm ran away"), "ran away"),
        (run("", tune.SOLVER, 500.0, ended="oscillated: joint_7"), "joint_7"),
    ):
        refused = tune.score(candidate, [*usual, bad])
        assert (refused.objective, said in refused.reason) == (math.inf, True)


def test_change_while_settled_is_that_of_the_same_trials():
    rows = [
        run("", name, 500.0, trial=k, settled_ticks=100, **{f"settled_{e}": value for e in tune.ERRORS}).row
        for k, both in enumerate([(0.1, 0.2), (0.2, 0.4), (0.3, 0.6)])
        for name, value in zip((tune.SOLVER, BASELINE), both, strict=True)
    ]  # fmt: skip
    values = tune.figures(Results(rows))
    assert values["settled_tip_error_model_mean_mm"] == pytest.approx(-50.0)
    assert "travelling_tip_error_model_mean_mm" not in values


def test_search_and_experiment_share_no_trial():
    streams = [set(seeds(0, stream, 60)) for stream in (STREAM, tune.SEARCH_STREAM, tune.FINAL_STREAM)]
    assert len(set.union(*streams)) == 180


def test_the_preset_is_a_point_of_the_space(config):
    """The shipped preset names its command; it must be what that command can draw."""
    gains = load_data("lwr4").gains["tuned"]
    for name, span in config.space.items():
        value = TUNED["regularization"] / 1e-3 if name == "rho_over_c2" else {**gains, **TUNED}[name]
        assert value in span.choices if span.choices else span.low * 0.99 <= value <= span.high * 1.01
    assert ControlSettings.tuned() == ControlSettings(**TUNED)


def test_the_command_repeats_itself(tiny):
    one, two = (tiny(tune, TINY, pictures=0).summary for _ in range(2))
    assert one == two
    assert set(one["tuned"]["control"]) == {"gains", "K_N2", "regularization"}


def test_choices_are_drawn_evenly():
    span = tune.Range(choices=[False, True])
    assert [span.at(place) for place in (0.0, 0.49, 0.51, 1.0)] == [False, False, True, True]
