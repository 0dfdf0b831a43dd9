"""The names others call, as docs and README spell them: they change with a major version only."""

import inspect

import numpy as np

import moc_opt as mo

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
