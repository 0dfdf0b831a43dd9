"""The subproblem is what its equation says, and bad input is named."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import SubproblemError
from moc_opt.qp.problem import NullSpaceQP, compute_residuals, fields
from tests.problems import random_problem


@pytest.fixture
def arguments():
    rng = np.random.default_rng(1)
    qp = random_problem(rng)
    return {
        "J_tip": qp.J_tip,
        "J_wrist": qp.J_wrist,
        "v_tip": qp.v_tip,
        "v_wrist": qp.v_wrist,
        "grad_mu": qp.grad_mu,
        "lower": qp.lower,
        "upper": qp.upper,
        "c0": 0.02,
        "c1": 0.03,
        "c2": 0.004,
        "regularization": 1e-4,
    }


def test_cost_matches_its_definition(arguments):
    qp = NullSpaceQP(**arguments)
    rng = np.random.default_rng(2)
    for _ in range(20):
        x = rng.normal(size=7)
        tip, wrist = qp.J_tip @ x - qp.v_tip, qp.J_wrist @ x - qp.v_wrist
        direct = 0.01 * tip @ tip + 0.015 * wrist @ wrist - 0.004 * x @ qp.grad_mu + 0.5e-4 * x @ x
        constant = 0.01 * qp.v_tip @ qp.v_tip + 0.015 * qp.v_wrist @ qp.v_wrist
        assert qp.objective(x) + constant == pytest.approx(direct, rel=1e-12)
        step = 1e-6 * np.eye(7)
        slope = [(qp.objective(x + d) - qp.objective(x - d)) / 2e-6 for d in step]
        np.testing.assert_allclose(qp.P @ x + qp.p, slope, atol=1e-8)


def test_everything_is_read_only(arguments):
    qp = NullSpaceQP(**arguments)
    for name in (
        "J_tip",
        "J_wrist",
        "v_tip",
        "v_wrist",
        "grad_mu",
        "lower",
        "upper",
        "A",
        "b",
        "P",
        "p",
        "row",
    ):
        with pytest.raises(ValueError, match="read-only"):
            getattr(qp, name)[...] = 0.0
    with pytest.raises(AttributeError, match="frozen"):
        qp.c2 = 1.0
    arguments["grad_mu"] = np.array(arguments["grad_mu"])
    kept = NullSpaceQP(**arguments)
    arguments["grad_mu"][0] = 9.0
    assert kept.grad_mu[0] != 9.0


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("J_tip", np.ones((2, 7)), "J_tip"),
        ("J_wrist", np.ones((3, 6)), "J_wrist"),
        ("v_tip", np.ones(2), "v_tip"),
        ("v_wrist", "fast", "v_wrist"),
        ("grad_mu", np.r_[np.nan, np.ones(6)], "entry"),
        ("lower", np.full(7, 9.0), "above"),
        ("upper", np.full(7, np.inf), "upper"),
        ("c0", -1.0, "negative"),
        ("c2", np.nan, "c2"),
        ("regularization", -1e-9, "regularization"),
        ("q", np.ones(3), "q:"),
        ("c1", [1.0, 2.0], "c1"),
    ],
)
def test_bad_input_names_the_field(arguments, field, value, says):
    arguments[field] = value
    with pytest.raises(SubproblemError, match=says):
        NullSpaceQP(**arguments)


def test_the_former_name_of_the_regularization(arguments):
    rho = arguments.pop("regularization")
    assert NullSpaceQP(**arguments).regularization == 1e-5
    old, new = NullSpaceQP(**arguments, damping=rho), NullSpaceQP(**arguments, regularization=rho)
    assert old == new
    assert (old.damping, new.damping) == (rho, rho)
    with pytest.raises(SubproblemError, match=r"regularization: 1e-05 stands beside damping = 1e-05.*keep one"):
        NullSpaceQP(**arguments, regularization=1e-5, damping=1e-5)
    with pytest.raises(SubproblemError, match=r"regularization: -1\.0 is negative"):
        NullSpaceQP(**arguments, damping=-1.0)


def test_record_round_trip(arguments):
    qp = NullSpaceQP(**arguments)
    assert qp.q is None
    again = NullSpaceQP.from_row(np.array(qp.row))
    assert again == qp
    assert pickle.loads(pickle.dumps(qp)) == qp
    assert NullSpaceQP(**{**arguments, "q": np.arange(7.0)}).q.tolist() == list(range(7))
    with pytest.raises(SubproblemError, match="10 n"):
        fields(np.zeros(83))


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), structured=st.booleans())
def test_five_rows_say_the_same_as_six(seed, structured):
    rng = np.random.default_rng(seed)
    qp = random_problem(rng, structured=structured)
    five = qp.reduced()
    assert five.A.shape == (5, 7)
    x = np.linalg.lstsq(five.A, five.b, rcond=None)[0]
    np.testing.assert_allclose(qp.A @ x, qp.b, atol=1e-10)
    y5 = rng.normal(size=5)
    np.testing.assert_allclose(five.A.T @ y5, qp.A.T @ (five.lift.T @ y5), atol=1e-12)


def test_six_rows_stay_where_nothing_ties_tip_and_wrist():
    rng = np.random.default_rng(3)
    qp = NullSpaceQP(
        rng.normal(size=(3, 7)),
        rng.normal(size=(3, 7)),
        np.zeros(3),
        np.zeros(3),
        np.ones(7),
        -np.ones(7),
        np.ones(7),
    )
    assert qp.reduced().A.shape == (6, 7)


def test_batch_judges_like_one_by_one():
    rng = np.random.default_rng(4)
    problems = [random_problem(rng, structured=bool(i % 2)) for i in range(8)]
    X, Y = rng.normal(size=(8, 7)), rng.normal(size=(8, 6))
    together = compute_residuals(np.array([qp.row for qp in problems]), X, Y)
    for i, qp in enumerate(problems):
        np.testing.assert_allclose([f[i] for f in together], qp.residuals(X[i], Y[i]), atol=1e-9)


def test_residuals_check_shapes(arguments):
    qp = NullSpaceQP(**arguments)
    with pytest.raises(SubproblemError, match="x: shape"):
        qp.residuals(np.zeros(6))
    with pytest.raises(SubproblemError, match="five duals"):
        qp.residuals(np.zeros(7), np.zeros(5))


def test_a_record_in_other_memory_is_copied():
    """Compiled solvers read it as contiguous doubles."""
    row = np.array(random_problem(np.random.default_rng(2)).row)
    spread = np.repeat(row, 2)[::2]
    for held in (spread, row.astype(np.float32)):
        np.testing.assert_array_equal(NullSpaceQP.from_row(held).row, held)
        assert NullSpaceQP.from_row(held).row.strides == (8,)
    assert NullSpaceQP.from_row(row).row is row
