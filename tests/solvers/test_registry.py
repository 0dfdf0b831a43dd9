"""Solvers by name."""

import contextlib
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from moc_opt.errors import SolverError, UnknownNameError
from moc_opt.solvers import available, create, registry
from moc_opt.solvers.qpsolvers import ALLOWED, checked
from tests import broken_solvers
from tests.problems import random_problem

HERE = [name for name, reason in available().items() if reason is None]
ABSENT = next(name for name, reason in available().items() if reason is not None)


@pytest.fixture
def install(tmp_path, monkeypatch):
    def made(package, source, **points):
        named = {name.replace("__", ":"): what for name, what in points.items()}
        monkeypatch.syspath_prepend(broken_solvers.install(tmp_path / package, package, source, named))
        monkeypatch.delitem(sys.modules, package, raising=False)

    return made


GOOD_PLUGIN = """
from moc_opt.solvers.base import Solution, Status
class Good:
    name = "good"
    def supports(self, qp): return None
    def start(self, qp): return self
    def solve(self, qp): return Solution(0.5 * (qp.lower + qp.upper), None, Status.MAX_ITER)
"""


@pytest.mark.parametrize(("name", "given", "error", "cure"), [
    ("osqpp", {}, UnknownNameError, "did you mean .*'osqp'"), ("rn", {}, UnknownNameError, "did you mean .*'rnn'"),
    ("qpsolvers:dapq", {}, UnknownNameError, "did you mean 'daqp'"),
    ("osqp", {"max_itr": 10}, UnknownNameError, "setting of solver osqp: 'max_itr': did you mean 'max_iter'"),
    ("qpsolvers:daqp", {"eps": 1e-9}, UnknownNameError, "setting of solver qpsolvers:daqp: 'eps'"),
    (ABSENT, {}, SolverError, "cannot run: .*pip install qpsolvers"), (3, {}, SolverError, "give a solver's name"),
    ("osqp", {"eps": 10**400}, SolverError, "osqp: eps = 1000"),
])  # fmt: skip
def test_the_error_of_a_wrong_name_or_setting_gives_the_remedy(name, given, error, cure):
    with pytest.raises(error, match=cure):
        create(name, **given)


@pytest.mark.parametrize(("name", "field", "value"), [
    ("exact", "tolerance", 0.0), ("osqp", "rows", 7), ("osqp", "rows", True), ("osqp", "eps_rel", -1.0),
    ("osqp", "max_iter", 1e4), ("osqp", "max_iter", 2**31), ("osqp", "check_termination", 0), ("osqp", "polishing", 1),
    ("osqp", "max_iter", True), ("osqp", "eps", "1e-9"), ("qpsolvers:daqp", "options", 3),
    ("rnn", "h", 1.5), ("rnn", "scale", float("nan")), ("rnn", "scale", float("inf")), ("rnn", "method", "implicit"),
    ("rnn-printed", "h", 1.5), ("nlp-sqp", "kinematics", None), ("nlp-sqp", "hessian", "bfgs"),
])  # fmt: skip
def test_error_names_the_bad_setting(name, field, value):
    arm = {"kinematics": SimpleNamespace(n=7, tip=None, wrist=None, mu=None)} if name.startswith("nlp") else {}
    with pytest.raises(SolverError, match=re.escape(f"{name}: {field} = {value!r} ")):
        create(name, **{**arm, field: value})


def test_solver_without_its_package_is_unavailable(monkeypatch):
    assert set(registry.BUILT_IN) <= set(HERE)
    monkeypatch.setattr(registry, "find_spec", lambda package: None)
    reasons = available()
    assert "pip install osqp" in reasons["osqp"]
    assert "pip install qpsolvers" in reasons["qpsolvers:NAME"]
    assert reasons["exact"] is None
    with pytest.raises(SolverError, match="pip install proxsuite"):
        create("proxqp")
    with pytest.raises(UnknownNameError):
        create("qpsolvers:daqp")


BROKEN = {
    "no such module": ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
    "exits when imported": ("raise SystemExit(3)", "SystemExit: 3"),
    "no class": ("C = [1, 2]", "'list' object is not callable"),
    "no supports": (GOOD_PLUGIN + "class C(Good):\n supports = None", "has no method `supports`: add what is missing"),
    "no name": (GOOD_PLUGIN + "class C(Good):\n name = None", "has no name"),
    "makes nothing": ("def C(): return None", "has no method `supports` and no `start`"),
    "raises when made": (GOOD_PLUGIN + "class C(Good):\n def __init__(self): raise ValueError('boom')", "Error: boom"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_plug_in_does_not_hide_other_solvers(case, install):
    source, message = BROKEN[case]
    install("bad_plugin", source, broken="C")
    install("good_plugin", GOOD_PLUGIN, good="Good")
    reasons = available()
    assert message in reasons["broken"]
    assert "entry point 'bad_plugin:C' of package 'bad_plugin'" in reasons["broken"]
    assert reasons["good"] is reasons["exact"] is None
    assert create("good").name == "good"
    with pytest.raises(SolverError) as refused:
        create("broken")
    assert str(refused.value) == reasons["broken"]


@pytest.mark.parametrize("name", ["osqp", "qpsolvers:daqp"])
def test_plug_in_with_built_in_name_is_not_used(name, install):
    install("impostor", GOOD_PLUGIN, **{name.replace(":", "__"): "Good"})
    reasons = available()
    assert reasons[name] is None
    assert "rename the entry point" in reasons[f"{name} (entry point 'impostor:Good' of package 'impostor')"]
    with pytest.warns(UserWarning, match=f"entry point 'impostor:Good' of package 'impostor': the name '{name}'"):
        assert create(name).name == name


@pytest.mark.parametrize(("solver", "options"), [
    ("scs", "log_csv_filename write_data_filename linear_solver"), ("osqp", "linsys_solver solver_type device"),
    ("highs", "log_file solution_file write_model_to_file read_basis_file log_to_console"),
    ("clarabel", "direct_solve_method pardiso_verbose"), ("daqp", "initvals is_avi break_points"),
    ("quadprog", "factorized verbose"), ("gurobi", "LogFile ResultFile NodefileDir"), ("cvxopt", "mosek solver"),
])  # fmt: skip
def test_error_names_the_dangerous_option(solver, options):
    for option in options.split():
        with pytest.raises(UnknownNameError, match=f"option of qpsolvers:{solver} '{option}'"):
            checked(f"qpsolvers:{solver}", {option: 1})


@pytest.mark.parametrize("value", ["1e-6", "/tmp/x", [1.0], {"a": 1}, None, float("nan"), float("inf"), 2**70, 1e300])
def test_option_must_be_a_flag_or_finite_number(value):
    with pytest.raises(SolverError, match=r"qpsolvers:osqp: option eps_abs = .*give true, false or a number"):
        checked("qpsolvers:osqp", {"eps_abs": value})


@pytest.mark.parametrize("solver", [name for name in HERE if ALLOWED.get(name)])
def test_library_accepts_every_option_on_its_list(solver):
    qp = random_problem(np.random.default_rng(0))
    brief = {name: 20 for name in ("max_iter", "max_iters", "iter_limit") if name in ALLOWED[solver]}
    for option in sorted(ALLOWED[solver]):
        taken = []
        for value in (1e-6, 10, 0.5, 1, True, 0):
            with contextlib.suppress(SolverError):
                taken.append(create(solver, options={**brief, option: value}).start(qp))
        assert taken, option


def test_ipopt_reads_no_options_from_current_folder(tmp_path):
    """An ipopt.opt in the current folder could make IPOPT load any library."""
    (tmp_path / "ipopt.opt").write_text("output_file written.txt\nfile_print_level 5\n")
    program = (
        "from moc_opt.scenario import Scenario, run\n"
        "trace = run(Scenario(solver={'name': 'nlp-ipopt', 'settings': {}}, duration_s=0.006, bound_samples=0))\n"
        "assert (trace.status == 'solved').any()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert os.listdir(tmp_path) == ["ipopt.opt"]
