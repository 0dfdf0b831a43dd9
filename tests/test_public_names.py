"""The names others call, as docs and README spell them: they change with a major version only."""

import inspect

import numpy as np

import moc_opt as mo
from moc_opt import errors
from moc_opt.trace.metrics import METRICS

NAMES = "MocOptError NullSpaceQP RobotModel RobotState Scenario Trace compare load_robot load_trace plan run solvers"
STATE = "tip wrist J_tip J_wrist mu grad_mu M h"
METRIC_NAMES = """
    mu_mean mu_final mu_gain_percent mu_fraction_of_bound mu_fraction_of_best_from_start mu_fraction_of_best
    tip_error_mean_mm tip_error_max_mm rcm_error_mean_mm rcm_error_max_mm rcm_error_registered_mean_mm
    trocar_force_mean_N trocar_force_max_N torque_rate_rms_Nm_per_s solve_p50_us solve_p99_us tick_p50_us tick_p99_us
    deadline_misses claimed_solved verified_solved silently_wrong primal_max natural_max loss_max"""
COLUMNS = """
    t_s q_rad v_rad_per_s tau_Nm tip_m tip_ref_m wrist_m trocar_m mu tip_error_m rcm_error_m trocar_force_N
    x_rad_per_s status solve_us tick_us"""
SOLVERS = "exact rnn rnn-printed osqp proxqp nlp-sqp nlp-ipopt"


def test_each_name_is_there():
    assert {*NAMES.split(), "summarize"} <= set(mo.__all__) <= set(dir(mo))


def test_subproblem_signature():
    parameters = inspect.signature(mo.NullSpaceQP).parameters
    names = "J_tip J_wrist v_tip v_wrist grad_mu lower upper c0 c1 c2 regularization q pull"
    assert " ".join(parameters) == names
    defaults = {name: p.default for name, p in parameters.items() if p.default is not p.empty}
    assert defaults == {"c0": 0.01, "c1": 0.01, "c2": 0.001, "regularization": 1e-5, "q": None, "pull": None}


def test_from_robot_to_summary(tmp_path):
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
    assert set(mo.summarize(trace)) <= set(METRICS)
    trace.save(tmp_path / "trace.parquet")
    assert len(mo.load_trace(tmp_path / "trace.parquet")) == 10


def test_names_of_metrics_and_solvers():
    assert set(METRICS) >= set(METRIC_NAMES.split())
    available = mo.solvers.available()
    assert set(available) >= set(SOLVERS.split())
    assert any(name.startswith("qpsolvers:") for name in available)


def test_every_error_of_the_package_is_one_kind():
    classes = [c for _, c in inspect.getmembers(errors, inspect.isclass) if issubclass(c, Exception)]
    assert len(classes) > 5
    assert all(issubclass(c, mo.MocOptError) for c in classes)
