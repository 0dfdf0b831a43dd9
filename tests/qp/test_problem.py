"""The subproblem is what its equation says, in its record and as solvers take it, and bad input is named."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import SubproblemError
from moc_opt.qp.equalities import assembled
from moc_opt.qp.layout import C0, C1, C2, RHO, joints_of, offsets
from moc_opt.qp.problem import NullSpaceQP, fields, row_length
from tests.problems import random_problem


@pytest.fixture
def arguments():
    qp = random_problem(np.random.default_rng(1))
    parts = {name: getattr(qp, name) for name in (
        "J_tip", "J_wrist", "v_tip", "v_wrist", "grad_mu", "lower", "upper",
    )}  # fmt: skip
    return {**parts, "c0": 0.02, "c1": 0.03, "c2": 0.004, "regularization": 1e-4}


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
    for name in ("J_tip", "J_wrist", "v_tip", "v_wrist", "grad_mu", "lower", "upper", "A", "b", "P", "p", "row"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(qp, name)[...] = 0.0
    with pytest.raises(AttributeError, match="frozen"):
        qp.c2 = 1.0
    arguments["grad_mu"] = np.array(arguments["grad_mu"])
    kept = NullSpaceQP(**arguments)
    arguments["grad_mu"][0] = 9.0
    assert kept.grad_mu[0] != 9.0


@pytest.mark.parametrize(("field", "value"), [
    ("J_tip", np.ones((2, 7))), ("J_wrist", np.ones((3, 6))), ("v_tip", np.ones(2)), ("v_wrist", "fast"),
    ("grad_mu", np.r_[np.nan, np.ones(6)]), ("lower", np.full(7, 9.0)), ("upper", np.full(7, np.inf)), ("c0", -1.0),
    ("c2", np.nan), ("regularization", -1e-9), ("q", np.ones(3)), ("c1", [1.0, 2.0]), ("c2", 2e12),
])  # fmt: skip
def test_bad_input_names_the_field(arguments, field, value):
    arguments[field] = value
    with pytest.raises(SubproblemError, match=f"^{field}: "):
        NullSpaceQP(**arguments)


def test_record_round_trip(arguments):
    qp = NullSpaceQP(**arguments)
    assert qp.q is None
    again = NullSpaceQP.from_row(np.array(qp.row))
    assert again == qp
    assert pickle.loads(pickle.dumps(qp)) == qp
    assert NullSpaceQP(**{**arguments, "q": np.arange(7.0)}).q.tolist() == list(range(7))
    with pytest.raises(SubproblemError, match="11 n"):
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


# --- as solvers take it ---


def agree(qp):
    found = assembled(qp)
    np.testing.assert_allclose(found.P, qp.P, atol=1e-15)
    np.testing.assert_allclose(found.p, qp.p, atol=1e-15)
    for ours, theirs in zip(found[2:], qp.reduced(), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-14)
    return found


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), n=st.sampled_from([6, 7, 9]), structured=st.booleans())
def test_kernel_equals_the_plain_form(seed, n, structured):
    found = agree(random_problem(np.random.default_rng(seed), n, structured=structured))
    assert found.A.shape == (5, n)


@settings(max_examples=100)
@given(
    seed=st.integers(0, 10_000), n=st.sampled_from([1, 2, 3, 7]), rank=st.integers(0, 3),
    apart=st.sampled_from([0.0, 1e-9, 0.9e-7, 1.1e-7, 1e-5]), size=st.sampled_from([1e-3, 1.0, 1e3]),
)  # fmt: skip
def test_both_draw_the_same_line(seed, n, rank, apart, size):
    """Around the tolerance, where J_T - J_W loses more than one direction, and with fewer joints than directions."""
    rng = np.random.default_rng(seed)
    J_tip, u = rng.normal(size=(3, n)), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    difference = u[:, :rank] @ rng.normal(size=(rank, n)) + apart * u[:, 2:] @ rng.normal(size=(1, n))
    qp = NullSpaceQP(
        size * J_tip, size * (J_tip - difference), np.ones(3), np.ones(3), np.ones(n), -np.ones(n), np.ones(n)
    )
    assert assembled(qp).A.shape == qp.reduced().A.shape
    if n < 3 or (rank == 3 and apart > 1e-6):
        assert qp.reduced().A.shape == (6, n)


def test_six_rows_where_nothing_is_tied():
    rng = np.random.default_rng(3)
    J = rng.normal(size=(2, 3, 7))
    qp = NullSpaceQP(J[0], J[1], np.zeros(3), np.zeros(3), np.ones(7), -np.ones(7), np.ones(7))
    assert agree(qp).A.shape == (6, 7)
    found = assembled(random_problem(np.random.default_rng(4)), 6)  # and where six are asked for
    np.testing.assert_array_equal(found.lift, np.eye(6))
    assert found.A.shape == (6, 7)


def test_nothing_is_written_into_the_problem_and_all_is_read_only():
    qp = random_problem(np.random.default_rng(4))
    before = dict(qp.__dict__)
    found = assembled(qp)
    assert qp.__dict__.keys() - before.keys() <= {"fields"}
    assert not any(a.flags.writeable for a in (*found, qp.P, qp.p, *qp.reduced()))


# --- its record ---


@pytest.mark.parametrize("n", [1, 6, 7, 9])
def test_offsets_are_those_of_the_fields(n):
    record = np.arange(float(row_length(n)))
    named, at = fields(record), offsets(n)
    assert at.end == len(record)
    assert joints_of(at.end) == n
    for name in named._fields:
        assert getattr(named, name).ravel()[0] == getattr(at, name)
    assert sum(part.size for part in named) == at.end


def test_weights_by_name():
    qp = NullSpaceQP(*np.zeros((2, 3, 4)), *np.zeros((2, 3)), np.zeros(4), -np.ones(4), np.ones(4), 1.0, 2.0, 3.0, 4.0)
    weights = qp.row[offsets(4).weights :]
    assert (weights[C0], weights[C1], weights[C2], weights[RHO]) == (1.0, 2.0, 3.0, 4.0)
    assert (qp.c0, qp.c1, qp.c2, qp.regularization) == (1.0, 2.0, 3.0, 4.0)
