"""The names others call, as docs and README spell them; errors, whose messages stay short and name the nearest."""

import inspect

import numpy as np
import pytest

import moc_opt as mo
from moc_opt import errors
from moc_opt.errors import MocOptError, RobotError, TraceError, UnknownNameError

STATE = "tip wrist J_tip J_wrist mu grad_mu M h"
COLUMNS = """
    t_s q_rad v_rad_per_s tau_Nm tip_m tip_ref_m wrist_m trocar_m mu tip_error_m rcm_error_m trocar_force_N
    x_rad_per_s status solve_us tick_us"""


def test_subproblem_signature():
    parameters = inspect.signature(mo.NullSpaceQP).parameters
    names = "J_tip J_wrist v_tip v_wrist grad_mu lower upper c0 c1 c2 regularization q pull"
    assert " ".join(parameters) == names
    defaults = {name: p.default for name, p in parameters.items() if p.default is not p.empty}
    assert defaults == {"c0": 0.01, "c1": 0.01, "c2": 0.001, "regularization": 1e-5, "q": None, "pull": None}


def test_from_robot_to_summary(tmp_path):
    assert set(mo.__all__) <= set(dir(mo))
    robot = mo.load_robot("lwr4", tool_length=0.30)
    q = np.array(robot.data.q_home)
    state = robot.state(q, np.zeros(robot.n))
    assert all(getattr(state, name) is not None for name in STATE.split())

    still = np.zeros(3)
    qp = mo.NullSpaceQP(state.J_tip, state.J_wrist, still, still, state.grad_mu, -robot.v_max, robot.v_max, q=q)
    assert (qp.P.shape, qp.p.shape, qp.A.shape, qp.b.shape) == ((7, 7), (7,), (6, 7), (6,))
    assert qp.reduced().A.shape == (5, 7)
    solution = mo.solvers.create("exact").start(qp).solve(qp)
    found = qp.residuals(solution.x, solution.y)
    assert {"primal", "natural", "relative", "loss"} <= set(found._fields)
    assert found.verified()

    file = tmp_path / "scenario.toml"
    file.write_text("duration_s = 0.02\nbound_samples = 2\n", encoding="utf-8")
    trace = mo.run(mo.Scenario.load(file))
    assert set(trace.columns) >= set(COLUMNS.split())
    assert mo.summarize(trace)["mu_mean"] == trace.mu.mean()
    trace.save(tmp_path / "trace.parquet")
    assert len(mo.load_trace(tmp_path / "trace.parquet")) == 10


@pytest.mark.parametrize("kind", [MocOptError, RobotError, TraceError])
def test_a_text_of_a_megabyte_is_cut(kind):
    assert str(kind("a field, its value and the cure")) == "a field, its value and the cure"
    assert str(kind("x" * 2000)) == "x" * 2000
    cut = str(kind("begins so " + "x" * 10**6))
    assert (len(cut), cut[:13], cut[-3:]) == (2000, "begins so xxx", "...")


KEYS = ["replay_us", "name", "settings.eps", "settings.eps_rel", "settings.name"]
MANY = [*(f"name_{i}" for i in range(500)), "osqp", "proxqp", "nlp-ipopt"]


@pytest.mark.parametrize(("name", "valid", "told"), [
    ("eps", KEYS, "did you mean 'settings.eps' or 'settings.eps_rel'"),  # a key without its table
    ("nam", KEYS, "did you mean 'name' or 'settings.name'?"), ("setings.eps", KEYS, "did you mean 'settings.eps'"),
    ("name_7x", MANY, "did you mean 'name_7'"), ("proxpq", MANY, "did you mean 'proxqp'? `"),
    ("a", MANY[:3], "valid names: name_0, name_1, name_2"),
])  # fmt: skip
def test_the_nearest_names_stand_and_of_a_long_list_only_these(name, valid, told):
    text = str(UnknownNameError("metric", name, valid, "moc-opt metrics"))
    assert told in text
    assert text.endswith("`moc-opt metrics` lists all 503") == (valid is MANY)
    assert text.count("name_") <= 4  # what was written, and three


def test_every_error_of_the_package_is_one_kind():
    classes = [c for _, c in inspect.getmembers(errors, inspect.isclass) if issubclass(c, Exception)]
    assert len(classes) > 5
    assert all(issubclass(c, MocOptError) for c in classes)
