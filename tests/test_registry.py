"""Solvers by name: what is there, what is not and why, and how others add their own."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import SolverError, UnknownNameError
from moc_opt.solvers import Solver, Status, available, create, registry
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
    found = [EntryPoint(name, value, registry.ENTRY_POINTS) for name, value in points.items()]
    announced = {registry.ENTRY_POINTS: found}
    monkeypatch.setattr(registry, "entry_points", lambda group: announced.get(group, []))


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
    publish(monkeypatch, still="tests.test_registry:Still")
    assert available()["still"] is None
    assert "still" in registry.names()
    solver = create("still", eps=0.1)
    assert solver.eps == 0.1
    qp = random_problem(np.random.default_rng(0))
    assert solver.start(qp).solve(qp).status is Status.MAX_ITER
    with pytest.raises(UnknownNameError, match=r"valid names: .*eps"):
        create("still", epss=0.1)


def test_a_broken_plug_in_hides_nothing(monkeypatch):
    publish(monkeypatch, broken="no_such_module:Solver", osqp="tests.test_registry:Still")
    found = available()
    assert "no_such_module" in found["broken"]
    assert found["exact"] is None
    assert create("osqp").name == "osqp"  # a plug-in does not replace a built-in solver


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
