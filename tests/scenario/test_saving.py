"""What a scenario writes is what it is: the file it saves loads as the same scenario."""

from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import ScenarioError
from moc_opt.scenario.config import Scenario

NOT_NEGATIVE = st.just(0.0) | st.floats(1e-6, 90.0)
NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,8}[A-Za-z0-9_]", fullmatch=True).filter(lambda s: ".." not in s)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
FINITE = st.floats(1e-20, 1e6) | st.integers(-9, 9) | st.booleans() | TEXT


def table(**fields):
    return st.fixed_dictionaries({}, optional=fields)


SCENARIOS = table(
    name=NAMES, seed=st.integers(0, 2**63 - 1), duration_s=st.none() | st.floats(0.01, 100.0),
    control=table(
        preset=st.sampled_from(["paper", "tuned", "robust"]),
        K_N2=st.floats(0.1, 200.0) | st.lists(NOT_NEGATIVE, min_size=7, max_size=7),
        gains=st.sampled_from([None, "moc", "default"]), rcm_lambda=st.none() | st.floats(0.1, 1.0),
        regularization=st.floats(1e-9, 1.0), fallback=st.sampled_from(["damping", "hold"]),
        supervisor=table(budget_us=st.floats(1.0, 1e4)),
    ),
    plant=table(
        preset=st.sampled_from(["nominal", "realistic"]), friction=st.floats(1e-6, 3.0),
        delay_ticks=st.integers(0, 4), gravity=st.booleans(),
    ),
    task=table(
        path=st.sampled_from(["circle", "spiral"]), sizes=st.dictionaries(st.just("radius"), st.floats(0.01, 0.1)),
        heading=st.tuples(*[st.floats(0.1, 1.0)] * 3),
    ),
    solver=table(
        name=st.sampled_from(["exact", "rnn", "osqp"]),
        settings=st.dictionaries(NAMES, FINITE | st.lists(FINITE, max_size=3), max_size=3),
        replay_us=st.none() | st.lists(NOT_NEGATIVE, max_size=3),
    ),
    guard=table(position_margin_rad=st.floats(0.001, 0.1)),
)  # fmt: skip


@settings(max_examples=100)
@given(SCENARIOS)
def test_what_is_saved_loads_as_the_same(tmp_path_factory, values):
    scenario = Scenario(**values)
    file = tmp_path_factory.mktemp("saved") / "scenario.toml"
    scenario.save(file)
    assert Scenario.load(file) == scenario
    assert eval(repr(scenario), {"Scenario": Scenario}) == scenario


def test_only_what_differs_is_written(tmp_path):
    scenario = Scenario(seed=3, control={"preset": "tuned", "K_N2": 20.0}, plant={"preset": "nominal"})
    assert scenario.changes() == {
        "seed": 3, "control": {"preset": "tuned", "K_N2": 20.0}, "plant": {"preset": "nominal"},
    }  # fmt: skip
    Scenario().save(tmp_path / "a.toml")
    assert (tmp_path / "a.toml").read_text(encoding="utf-8").strip() == ""
    assert repr(Scenario()) == "Scenario()"


def test_every_limit_that_can_be_lifted_can_be_saved_lifted(tmp_path):
    optional = {key: type(None) in get_args(kind.annotation) for key, kind in SafetyFilterSettings.model_fields.items()}
    lifted = [key for key, value in Scenario().guard if optional[key] and value is not None]
    assert "stop_yield_N" in lifted
    scenario = Scenario(guard=dict.fromkeys(lifted), control={"gains": None})
    scenario.save(tmp_path / "lifted.toml")
    assert Scenario.load(tmp_path / "lifted.toml") == scenario


def test_a_solver_setting_of_none_is_left_out_where_that_means_the_same(tmp_path):
    to = tmp_path / "new" / "folder" / "a.toml"
    Scenario(solver={"name": "qpsolvers:quadprog", "settings": {"cost_scale": None, "rows": 6}}).save(to)
    assert Scenario.load(to).solver.settings == {"rows": 6}
    with pytest.raises(ScenarioError, match=r"solver.settings.kinematics = <object .* has no form in TOML"):
        Scenario(solver={"name": "osqp", "settings": {"kinematics": object()}}).save(to)
    assert Scenario.load(to).solver.settings == {"rows": 6}
