"""The parts of the C supervisor on their own, beside the Python functions that they repeat, on drawn subproblems."""

from __future__ import annotations

import ctypes
import shutil
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moc_opt.control import ControlSettings
from moc_opt.control.null_space import into_the_box, null_space
from moc_opt.control.solution_check import answer_residuals
from moc_opt.embedded.guarded import GuardedController
from moc_opt.model.robot_model import RobotModel
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Status
from moc_opt.solvers.exact.solver import Exact

Array = NDArray[np.float64]
Library = ctypes.CDLL

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler (cc, gcc, clang) on the path"
)


@pytest.fixture(scope="module")
def library(robot: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> Library:
    """The exported C of the default law."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        return GuardedController(robot, ControlSettings(), Exact()).library


def at(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def drawn_problem(robot: RobotModel, seed: int, reach: float, straight: bool, damping: float = 1e-5) -> NullSpaceQP:
    """A pose anywhere, references that a joint velocity of this size meets, and a box of uneven width around zero."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(robot.q_min, robot.q_max)
    q[3] = 0.0 if straight else np.copysign(max(abs(q[3]), 0.3), q[3])
    state = robot.state(q)
    velocity = reach * rng.uniform(-1.0, 1.0, robot.n)
    lower, upper = -rng.uniform(0.1, 1.0, robot.n), rng.uniform(0.1, 1.0, robot.n)
    b = state.A @ velocity
    return NullSpaceQP(
        state.J_tip, state.J_wrist, b[:3], b[3:], state.grad_mu, lower, upper, regularization=damping, q=q
    )  # fmt: skip


@settings(max_examples=400)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.3, 0.7), straight=st.booleans())
def test_the_retreat_is_that_of_python(
    library: Library, robot: RobotModel, seed: int, reach: float, straight: bool
) -> None:
    qp = drawn_problem(robot, seed, reach, straight)
    part, found = qp.fields, np.empty(qp.n)
    Z = null_space(part.A)
    library.moc_retreat(at(np.array(qp.row)), at(Z), len(Z), at(found))
    expected = into_the_box(part.A, part.b, Z, part.lower, part.upper, 50)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_some_retreats_need_more_than_a_sweep_and_some_have_no_way(robot: RobotModel) -> None:
    """Or the test above would pass with a single sweep."""
    kinds = {"one": 0, "more": 0, "none": 0}
    for seed in range(200):
        qp = drawn_problem(robot, seed, 0.6, seed % 2 == 0)
        part = qp.fields
        Z = null_space(part.A)
        one, all_ = (into_the_box(part.A, part.b, Z, part.lower, part.upper, sweeps) for sweeps in (1, 50))
        kinds["none" if not all_.any() else "one" if np.abs(one - all_).max() < 1e-9 else "more"] += 1
    assert min(kinds.values()) > 4, kinds


@settings(max_examples=150)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.0, 2.0), damping=st.sampled_from([0.0, 1e-5, 1e-3]))
def test_an_answer_is_judged_as_in_python(
    library: Library, robot: RobotModel, seed: int, reach: float, damping: float
) -> None:
    qp = drawn_problem(robot, seed, reach, False, damping)
    rng = np.random.default_rng(seed)
    solution = Exact().start(qp).solve(qp)
    x = np.array(solution.x) if solution.status is Status.SOLVED else rng.uniform(-1.0, 1.0, qp.n)
    Z = null_space(qp.fields.A)
    x += rng.choice([0.0, 1e-3, 0.1]) * (Z.T @ rng.normal(size=len(Z)))
    five: Any = type("Residuals", (ctypes.Structure,), {"_fields_": [("x", ctypes.c_double * 5)]})
    library.moc_compute_residuals.restype = five
    found = list(library.moc_compute_residuals(at(np.array(qp.row)), at(Z), len(Z), at(x)).x)
    expected = answer_residuals(qp.row, qp.n, Z, x)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@settings(max_examples=200)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.0, 2.0), damping=st.sampled_from([0.0, 1e-5, 1e-3]))
def test_a_straight_elbow_has_the_answer_of_exact(
    library: Library, robot: RobotModel, seed: int, reach: float, damping: float
) -> None:
    qp = drawn_problem(robot, seed, reach, True, damping)
    row, x, Z = np.array(qp.row), np.empty(qp.n), np.empty((qp.n, qp.n))
    library.moc_eliminate.restype = type(
        "Plane", (ctypes.Structure,), {"_fields_": [("W", ctypes.c_double * 48), ("rest", ctypes.c_int * 16)]}
    )
    plane = library.moc_eliminate(at(row), ctypes.c_void_p(row.ctypes.data + 8 * 6 * qp.n))
    assert library.moc_kernel(ctypes.byref(plane), at(Z)) == 3
    np.testing.assert_allclose(qp.fields.A @ Z[:3].T, 0.0, atol=1e-12)
    np.testing.assert_allclose(Z[:3] @ Z[:3].T, np.eye(3), atol=1e-12)
    status = library.moc_singular_answer(ctypes.byref(plane), at(row), at(x))
    expected = Exact().start(qp).solve(qp)
    assert (status == 0) == (expected.status is Status.SOLVED)
    assert (status == 1) == (expected.status is Status.INFEASIBLE)
    if status == 0:
        np.testing.assert_allclose(x, expected.x, atol=1e-9)
