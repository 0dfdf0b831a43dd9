"""The names others call, as DESIGN.md section 4 spells them."""

import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import MocOptError
from moc_opt.trace.metrics import METRICS

ROOT = Path(__file__).resolve().parent.parent
NAMES = {
    "MocOptError", "NullSpaceQP", "RobotModel", "RobotState", "Scenario", "Trace", "load_robot", "run", "solvers",
    "summarize",
}  # fmt: skip
METRIC_NAMES = {
    "mu_mean", "mu_final", "mu_gain_percent", "mu_fraction_of_bound", "tip_error_mean_mm", "tip_error_max_mm",
    "rcm_error_mean_mm", "rcm_error_max_mm", "trocar_force_mean_N", "trocar_force_max_N", "torque_rate_rms_Nm_per_s",
    "solve_p50_us", "solve_p99_us", "tick_p50_us", "tick_p99_us", "deadline_misses", "claimed_solved",
    "verified_solved", "silently_wrong", "primal_max", "natural_max", "loss_max",
}  # fmt: skip
COLUMNS = {
    "t_s", "q_rad", "v_rad_per_s", "tau_Nm", "tip_m", "tip_ref_m", "wrist_m", "trocar_m", "mu", "tip_error_m",
    "rcm_error_m", "trocar_force_N", "x_rad_per_s", "status", "solve_us", "tick_us",
}  # fmt: skip
SOLVERS = {"exact", "rnn", "rnn-printed", "osqp", "proxqp", "nlp-sqp", "nlp-ipopt"}


def test_public_names():
    assert set(mo.__all__) >= NAMES
    assert set(dir(mo)) >= NAMES
    for name in mo.__all__:
        assert getattr(mo, name) is not None
        if inspect.isclass(getattr(mo, name)) or inspect.isfunction(getattr(mo, name)):
            assert getattr(mo, name).__doc__, f"{name} has no docstring"


@pytest.mark.parametrize("name", ["NullSpaceQP", "Scenario", "load_robot", "solvers"])
def test_each_name_loads_on_its_own(name):
    """Whatever is asked for first, in a fresh interpreter."""
    found = subprocess.run(
        [sys.executable, "-c", f"import moc_opt; moc_opt.{name}"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr


def test_star_import_and_submodules():
    namespace = {}
    exec("from moc_opt import *", namespace)
    assert set(namespace) >= NAMES
    from moc_opt import solvers

    assert mo.solvers is solvers


def test_subproblem_signature():
    parameters = inspect.signature(mo.NullSpaceQP).parameters
    assert list(parameters) == [
        "J_tip", "J_wrist", "v_tip", "v_wrist", "grad_mu", "lower", "upper", "c0", "c1", "c2", "regularization",
        "q", "pull",
    ]  # fmt: skip
    defaults = {name: p.default for name, p in parameters.items() if p.default is not p.empty}
    assert defaults == {"c0": 0.01, "c1": 0.01, "c2": 0.001, "regularization": 1e-5, "q": None, "pull": None}


def test_the_printed_example(tmp_path):
    """The lines of the design, from robot to summary."""
    robot = mo.load_robot("lwr4", tool_length=0.30)
    q, v = np.array(robot.data.q_home), np.zeros(robot.n)
    state = robot.state(q, v)
    for name in ("tip", "wrist", "J_tip", "J_wrist", "mu", "grad_mu", "M", "h"):
        assert getattr(state, name) is not None

    lower, upper = -robot.v_max, robot.v_max
    qp = mo.NullSpaceQP(
        state.J_tip, state.J_wrist, np.zeros(3), np.zeros(3), state.grad_mu, lower, upper,
        c0=0.01, c1=0.01, c2=0.001, regularization=1e-5, q=q,
    )  # fmt: skip
    assert (qp.P.shape, qp.p.shape, qp.A.shape, qp.b.shape) == ((7, 7), (7,), (6, 7), (6,))
    assert qp.reduced().A.shape == (5, 7)

    solver = mo.solvers.create("exact")
    session = solver.start(qp)
    solution = session.solve(qp)
    found = qp.residuals(solution.x, solution.y)
    assert found._fields[:2] == ("primal", "natural")
    assert {"relative", "loss"} <= set(found._fields)
    assert found.verified()

    file = tmp_path / "scenario.toml"
    file.write_text("duration_s = 0.02\nbound_samples = 2\n", encoding="utf-8")
    trace = mo.run(mo.Scenario.load(file))
    numbers = mo.summarize(trace)
    assert set(trace.columns) >= COLUMNS
    assert set(numbers) <= set(METRICS)
    assert set(METRICS) >= METRIC_NAMES
    trace.save(tmp_path / "trace.parquet")
    assert len(mo.Trace.load(tmp_path / "trace.parquet")) == 10


def test_solver_names():
    available = mo.solvers.available()
    assert set(available) >= SOLVERS
    assert any(name.startswith("qpsolvers:") for name in available)
    for name, reason in available.items():
        assert reason is None or len(reason) > 10, f"{name}: {reason!r}"


def test_every_error_of_the_package_is_one_kind():
    import moc_opt.errors as errors

    classes = [c for _, c in inspect.getmembers(errors, inspect.isclass) if issubclass(c, Exception)]
    assert len(classes) > 5
    assert all(issubclass(c, MocOptError) for c in classes)
    assert mo.MocOptError is MocOptError


def test_the_default_scenario_is_the_realistic_moc_run():
    default = mo.Scenario()
    assert default.control.law == "moc"
    assert default.solver.name == "exact"
    assert default.plant.friction > 0.0
    assert default.plant.mass_error > 0.0
    assert default.plant.delay_ticks == 1
    assert default.plant.period_s == 0.002
    assert default.plant.substep_s <= 0.001
