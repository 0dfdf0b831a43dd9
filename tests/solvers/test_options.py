"""Options of foreign libraries: what is allowed works, and nothing that writes, loads or compiles is passed on."""

import os
import subprocess
import sys

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from moc_opt.errors import SolverError
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.solvers import available, create
from moc_opt.solvers.options import ALLOWED, MOST, checked
from tests.problems import random_problem

HERE = sorted(name for name, reason in available().items() if reason is None and ":" in name)
WITH_OPTIONS = [name for name in HERE if ALLOWED.get(name)]

# Every option of a library here that makes, reads or names a file, loads, compiles, or replaces the problem.
HOSTILE = {
    "qpsolvers:scs": {"log_csv_filename": "x.csv", "write_data_filename": "x.bin", "linear_solver": "mkl"},
    "qpsolvers:highs": {
        "log_file": "x.log", "solution_file": "x.sol", "write_model_file": "x.lp", "write_model_to_file": True,
        "write_solution_to_file": True, "write_basis_file": "x.bas", "write_presolved_model_file": "x.lp",
        "read_solution_file": "/etc/passwd", "read_basis_file": "/etc/passwd", "log_to_console": True,
    },
    "qpsolvers:osqp": {"verbose": True, "linsys_solver": "mkl", "solver_type": "x", "device": 1},
    "qpsolvers:clarabel": {"verbose": True, "direct_solve_method": "pardiso-mkl", "pardiso_verbose": True},
    "qpsolvers:daqp": {"verbose": True, "initvals": [0.0], "is_avi": True, "break_points": [1]},
    "qpsolvers:quadprog": {"factorized": True, "verbose": True},
    "qpsolvers:gurobi": {"LogFile": "x.log", "ResultFile": "x.lp", "SolFiles": "x", "NodefileDir": "/tmp"},
    "qpsolvers:cvxopt": {"mosek": {}, "solver": "mosek"},
    "casadi:qrqp": {
        "dump": True, "dump_in": True, "dump_out": True, "dump_dir": "x", "dump_format": "mtx", "jit": True,
        "compiler": "shell", "jit_options": {"compiler": "touch x"}, "external_transform": [["x.so", "f"]],
        "print_time": True, "record_time": True, "main": True, "cache": {}, "specific_options": {},
    },
}  # fmt: skip


@pytest.mark.parametrize(("solver", "option"), [(name, key) for name, table in HOSTILE.items() for key in table])
def test_what_writes_loads_or_compiles_is_refused_by_name(solver, option, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SolverError, match=rf"{solver}: option '{option}' .* allowed are "):
        checked(solver, {option: HOSTILE[solver][option]})
    if solver in HERE:
        scenario = Scenario(
            solver={"name": solver, "settings": {"options": {option: HOSTILE[solver][option]}}},
            duration_s=0.01, bound_samples=0, judge=False,
        )  # fmt: skip
        with pytest.raises(SolverError, match=rf"option '{option}'"):
            run(scenario)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("value", ["1e-6", "/tmp/x", [1.0], {"a": 1}, None, float("nan"), float("inf"), 2**70, 1e300])
def test_a_value_is_a_flag_or_a_number(value):
    with pytest.raises(SolverError, match=r"qpsolvers:osqp: option eps_abs = .*give true, false or a number"):
        checked("qpsolvers:osqp", {"eps_abs": value})


def test_a_typing_error_is_told_the_nearest():
    with pytest.raises(SolverError, match="did you mean 'eps_abs'"):
        checked("qpsolvers:osqp", {"eps_bas": 1e-6})


@pytest.mark.parametrize("solver", HERE)
def test_the_solvers_own_options_are_among_the_allowed(solver):
    made = create(solver)
    advised = made.advice.options if hasattr(made, "advice") else {}
    assert dict(checked(solver, advised)) == dict(advised)


@pytest.mark.parametrize("solver", WITH_OPTIONS)
def test_every_allowed_option_exists(solver):
    """A list that names what a library does not know would promise what cannot be had."""
    qp = random_problem(np.random.default_rng(0))
    brief = {name: 20 for name in ("max_iter", "max_iters", "iter_limit") if name in ALLOWED[solver]}
    for option in sorted(ALLOWED[solver]):
        values = (1e-6, 10, 0.5, 1, True, 0)
        assert any(refusal(solver, {**brief, option: value}, qp) is None for value in values), option


def refusal(solver, options, qp):
    """Why these options are refused; None where a session starts."""
    try:
        create(solver, options=options).start(qp)
    except SolverError as error:
        return str(error)
    return None


values = st.one_of(st.booleans(), st.integers(-MOST, MOST), st.floats(-MOST, MOST), st.floats(0.0, 1.0))


@given(st.data())
@settings(max_examples=60, deadline=None, derandomize=True)
def test_any_option_and_value_ends_in_a_refusal_or_a_session(data):
    """With values of any size: a refusal, or a session that answers; and the folder stays as it was."""
    solver = data.draw(st.sampled_from([name for name in WITH_OPTIONS if "highs" not in name]))
    known = st.sampled_from(sorted(ALLOWED[solver]))
    table = data.draw(st.dictionaries(st.one_of(known, st.text(max_size=20)), values, max_size=3))
    table = {name: value for name, value in table.items() if "iter" not in name and "time" not in name}
    table |= {name: 20 for name in ("max_iter", "max_iters", "iter_limit") if name in ALLOWED[solver]}
    qp, before = random_problem(np.random.default_rng(1)), os.listdir()
    said = refusal(solver, table, qp)
    if said is None:
        assert set(table) <= ALLOWED[solver]
        assert create(solver, options=table).start(qp).solve(qp).x.shape == (qp.n,)
    else:
        assert any(repr(name)[1:-1] in said for name in table)
    assert os.listdir() == before


def test_ipopt_reads_no_options_from_the_current_folder(tmp_path):
    """A file ipopt.opt beside a scenario could name a file to write, or a library to load."""
    (tmp_path / "ipopt.opt").write_text("output_file written.txt\nfile_print_level 5\n")
    program = (
        "from moc_opt.scenario import Scenario, run\n"
        "trace = run(Scenario(solver={'name': 'nlp-ipopt', 'settings': {}}, duration_s=0.006, bound_samples=0))\n"
        "assert (trace.status == 'solved').any()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert os.listdir(tmp_path) == ["ipopt.opt"]


def test_a_scenario_may_set_what_is_allowed():
    chosen = {"name": "qpsolvers:osqp", "settings": {"options": {"max_iter": 500, "polishing": True}}}
    assert Setup(Scenario(solver=chosen)).solver().options == {"max_iter": 500, "polishing": True}
