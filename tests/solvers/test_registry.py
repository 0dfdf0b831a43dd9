"""Solvers by name: what is there, what is not and why, and how others add their own."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import moc_opt as mo
from benchmarks.common.config import choose
from moc_opt.__main__ import main
from moc_opt.errors import SolverError, UnknownNameError
from moc_opt.solvers import Solver, Status, available, create, plugins, registry
from moc_opt.solvers.base import Solution
from tests.problems import random_problem


@dataclass(frozen=True)
class Still:
    """A solver of a third party: it recommends to stand still."""

    eps: float = 1e-6
    name: str = "still"

    def supports(self, qp):
        return None

    def start(self, qp):
        return self

    def solve(self, qp):
        return Solution(np.zeros(qp.n), None, Status.MAX_ITER)


def publish(monkeypatch, **points):
    """Pretend that installed packages announce these entry points."""
    found = [EntryPoint(name, value, plugins.GROUP) for name, value in points.items()]
    monkeypatch.setattr(plugins, "entry_points", lambda group: found if group == plugins.GROUP else [])


@pytest.fixture
def install(tmp_path, monkeypatch):
    """A function `install(package, source, **entry points)`: a distribution on disk, as pip leaves it."""

    def made(package, source, **points):
        info = tmp_path / package / f"{package}-1.0.dist-info"
        info.mkdir(parents=True)
        (tmp_path / package / f"{package}.py").write_text(source)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        lines = [f"{name.replace('__', ':')} = {package}:{what}" for name, what in points.items()]
        (info / "entry_points.txt").write_text("\n".join([f"[{plugins.GROUP}]", *lines, ""]))
        monkeypatch.syspath_prepend(tmp_path / package)
        monkeypatch.delitem(sys.modules, package, raising=False)

    return made


WHOLE = """
from moc_opt.solvers.base import Solution, Status
class Good:
    name = "good"
    def supports(self, qp): return None
    def start(self, qp): return self
    def solve(self, qp): return Solution(0.5 * (qp.lower + qp.upper), None, Status.MAX_ITER)
"""


def test_every_built_in_solver_is_named_and_can_be_built():
    found = available()
    for name in registry.BUILT_IN:
        assert found[name] is None
        if not name.startswith("nlp-"):
            solver = create(name)
            assert isinstance(solver, Solver)
            assert solver.name == name
    assert any(name.startswith("qpsolvers:") and reason is None for name, reason in found.items())
    assert mo.solvers.create is create


def test_names_leave_out_what_qpsolvers_does_not_find():
    found, listed = available(), registry.names()
    assert set(registry.BUILT_IN) <= set(listed)
    assert {name for name in found if found[name] is None} <= set(listed)
    absent = [name for name in found if name.startswith("qpsolvers:") and found[name]]
    assert absent
    assert not set(absent) & set(listed)


@pytest.mark.parametrize(("wrong", "right"), [("osqpp", "osqp"), ("qpsolvers:dapq", "daqp"), ("rn", "rnn")])
def test_unknown_names_come_with_the_nearest(wrong, right):
    with pytest.raises(UnknownNameError, match=f"did you mean .*'{right}'"):
        create(wrong)


def test_unknown_settings_come_with_the_nearest():
    with pytest.raises(UnknownNameError, match="setting of solver 'osqp' 'max_itr': did you mean 'max_iter'"):
        create("osqp", max_itr=10)
    with pytest.raises(UnknownNameError, match="setting of solver 'qpsolvers:daqp' 'eps'"):
        create("qpsolvers:daqp", eps=1e-9)


def test_missing_packages_are_reasons_not_crashes(monkeypatch):
    monkeypatch.setattr(registry, "find_spec", lambda package: None)
    found = available()
    assert "pip install osqp" in found["osqp"]
    assert "pip install qpsolvers" in found["qpsolvers:NAME"]
    assert found["exact"] is None
    with pytest.raises(SolverError, match="pip install proxsuite"):
        create("proxqp")
    with pytest.raises(UnknownNameError):
        create("qpsolvers:daqp")


def test_third_parties_add_solvers_without_a_change_here(monkeypatch):
    publish(monkeypatch, still="tests.solvers.test_registry:Still")
    assert available()["still"] is None
    assert "still" in registry.names()
    solver = create("still", eps=0.1)
    assert solver.eps == 0.1
    qp = random_problem(np.random.default_rng(0))
    assert solver.start(qp).solve(qp).status is Status.MAX_ITER
    with pytest.raises(UnknownNameError, match=r"valid names: .*eps"):
        create("still", epss=0.1)


BROKEN = {
    "no such module": ("import no_such_module", "C", "ModuleNotFoundError: No module named 'no_such_module'"),
    "raises when imported": ("raise RuntimeError('boom at import')", "C", "RuntimeError: boom at import"),
    "exits when imported": ("raise SystemExit(3)", "C", "SystemExit: 3"),
    "no such class": ("", "C", "AttributeError"),
    "no class": ("C = [1, 2]", "C", "is a list: give a class or a function"),
    "no supports": (WHOLE + "class C(Good):\n supports = None", "C", r"has no supports \(a method of qp\)"),
    "no start": ("class C:\n name = 'c'\n def supports(self, qp): pass", "C", r"has no start \(a method of qp\)"),
    "no name": (WHOLE + "class C(Good):\n name = None", "C", r"has no name \(a text\)"),
    "makes nothing": ("def C(): return None", "C", r"has no supports \(a method of qp\), start \(.*\), name"),
    "raises when made": (WHOLE + "class C(Good):\n def __init__(self): raise ValueError('boom')", "C", "Error: boom"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_plug_in_is_a_reason_and_hides_nothing(case, install):
    source, what, message = BROKEN[case]
    install("bad_plugin", source, broken=what)
    install("good_plugin", WHOLE, good="Good")
    found = available()
    assert re.search(message, found["broken"])
    assert "entry point 'bad_plugin:C' of package 'bad_plugin'" in found["broken"]
    assert found["good"] is None
    assert found["exact"] is None
    assert create("good").name == "good"
    with pytest.raises(SolverError, match=message):
        create("broken")
    assert "broken" not in registry.names()


def test_a_plug_in_with_a_setting_that_has_no_default_is_there(install):
    install("asking", WHOLE + "class C(Good):\n def __init__(self, eps): self.eps = eps", asking="C")
    assert available()["asking"] is None
    assert create("asking", eps=0.25).eps == 0.25
    with pytest.raises(SolverError, match="eps"):
        create("asking")


@pytest.mark.parametrize("name", ["osqp", "qpsolvers:daqp"])
def test_a_plug_in_named_like_a_built_in_is_told_to_be_renamed(name, install):
    install("impostor", WHOLE, **{name.replace(":", "__"): "Good"})
    found = available()
    assert found[name] is None
    told = found[f"{name} (entry point 'impostor:Good' of package 'impostor')"]
    assert "built-in solver (moc_opt.solvers." in told
    assert "rename the entry point" in told
    with pytest.warns(UserWarning, match=f"entry point 'impostor:Good' of package 'impostor': the name '{name}'"):
        assert create(name).name == name  # the built-in one


def test_two_plug_ins_of_one_name_are_both_named(install):
    install("first_one", WHOLE, twin="Good")
    install("second_one", WHOLE, twin="Good")
    with pytest.raises(SolverError) as refused:
        create("twin")
    for told in (available()["twin"], str(refused.value)):
        assert "entry point 'first_one:Good' of package 'first_one'" in told
        assert "entry point 'second_one:Good' of package 'second_one'" in told
        assert "rename one" in told


def test_the_comparison_goes_on_beside_broken_plug_ins(install):
    install("bad_plugin", "raise RuntimeError('boom at import')", broken="C")
    install("impostor", WHOLE, osqp="Good")
    names, missing = choose("all")
    assert {"exact", "osqp"} <= set(names)
    assert "boom at import" in missing["broken"]
    assert "rename the entry point" in missing["osqp (entry point 'impostor:Good' of package 'impostor')"]


@pytest.mark.parametrize("name", ["exact", "rnn", "rnn-printed"])
def test_asking_what_there_is_needs_no_optional_package(name, monkeypatch):
    monkeypatch.setattr(registry, "find_spec", lambda package: None)
    assert create(name).name == name


def test_accepts():
    assert registry.accepts("osqp", "cost_scale")
    assert registry.accepts("nlp-sqp", "kinematics")
    assert registry.accepts("qpsolvers:daqp", "options")
    assert not registry.accepts("exact", "kinematics")


def test_defaults_are_values():
    """Also where a default is made anew each time, and where the settings are bound to a library's name."""
    assert registry.defaults("casadi:qrqp")["options"] == {}
    assert registry.defaults("qpsolvers:quadprog")["options"] == {}
    assert registry.defaults("osqp")["rows"] == 5


def test_the_command_line_says_what_a_solver_raised(install, tmp_path, capsys):
    install("boom_plugin", WHOLE + "class C(Good):\n def solve(self, qp): raise RuntimeError('boom')", boom="C")
    (tmp_path / "boom.toml").write_text('duration_s = 0.02\nbound_samples = 0\n[solver]\nname = "boom"\n')
    assert main(["run", str(tmp_path / "boom.toml"), "--json"]) == 0
    said = capsys.readouterr()
    assert "answer refused, raised: 10 of 10 ticks, first at 0.000 s: RuntimeError: boom" in said.err
    json.loads(said.out)
