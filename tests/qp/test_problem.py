"""NullSpaceQP: cost, equality rows, flat storage and errors for bad input."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import SubproblemError
from moc_opt.qp.problem import NullSpaceQP, fields, joints_of, row_length
from tests.problems import PARTS, changed, random_problem


@pytest.fixture
def qp():
    return random_problem(np.random.default_rng(1), c0=0.02, c1=0.03, c2=0.004, regularization=1e-4)


def test_cost_matches_its_definition(qp):
    rng = np.random.default_rng(2)
    for _ in range(20):
        x = rng.normal(size=7)
        tip, wrist = qp.J_tip @ x - qp.v_tip, qp.J_wrist @ x - qp.v_wrist
        direct = 0.01 * tip @ tip + 0.015 * wrist @ wrist - 0.004 * x @ qp.grad_mu + 0.5e-4 * x @ x
        constant = 0.01 * qp.v_tip @ qp.v_tip + 0.015 * qp.v_wrist @ qp.v_wrist
        assert qp.objective(x) + constant == pytest.approx(direct, rel=1e-12)
        slope = [(qp.objective(x + d) - qp.objective(x - d)) / 2e-6 for d in 1e-6 * np.eye(7)]
        np.testing.assert_allclose(qp.P @ x + qp.p, slope, atol=1e-8)


def test_arrays_and_weights_are_read_only(qp):
    for name in (*PARTS[:7], "A", "b", "P", "p", "row"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(qp, name)[...] = 0.0
    with pytest.raises(AttributeError, match="frozen"):
        qp.c2 = 1.0
    gradient = np.array(qp.grad_mu)
    kept = changed(qp, grad_mu=gradient)
    gradient[0] = 9.0
    assert kept.grad_mu[0] != 9.0


@pytest.mark.parametrize(("field", "value"), [
    ("J_tip", np.ones((2, 7))), ("J_wrist", np.ones((3, 6))), ("v_tip", np.ones(2)), ("v_wrist", "fast"),
    ("grad_mu", np.r_[np.nan, np.ones(6)]), ("lower", np.full(7, 9.0)), ("upper", np.full(7, np.inf)), ("c0", -1.0),
    ("c2", np.nan), ("regularization", -1e-9), ("q", np.ones(3)), ("c1", [1.0, 2.0]),
    ("c2", 2e12), ("c2", 10**400), ("v_tip", [10**400, 0, 0]),
])  # fmt: skip
def test_bad_input_names_the_field(qp, field, value):
    with pytest.raises(SubproblemError, match=f"^{field}: "):
        changed(qp, **{field: value})


def test_wrong_shape_of_x_or_y_is_named(qp):
    assert np.isnan(qp.objective(np.full(7, np.nan)))  # NaN is no error
    for given_x, given_y, said in ((np.zeros(6), None, "x: shape"), (np.zeros(7), np.zeros(5), "y: .*five duals")):
        with pytest.raises(SubproblemError, match=said):
            qp.residuals(given_x, given_y)


def test_subproblem_made_from_its_flat_array_is_equal(qp):
    plain = changed(qp, q=None, c2=1e12)
    assert plain.q is None
    assert changed(qp, q=np.arange(7.0)).q.tolist() == list(range(7))
    for one in (qp, plain):
        assert NullSpaceQP.from_row(np.array(one.row)) == pickle.loads(pickle.dumps(one)) == one.copy() == one
    assert plain not in (qp, "another kind")
    assert [qp.c0, qp.c1, qp.c2, qp.regularization] == qp.row[76:80].tolist() == [0.02, 0.03, 0.004, 1e-4]
    with pytest.raises(SubproblemError, match="11 n"):
        fields(np.zeros(83))


def test_only_contiguous_doubles_are_used_without_a_copy(qp):
    row = np.array(qp.row)
    for held in (np.repeat(row, 2)[::2], row.astype(np.float32)):
        np.testing.assert_array_equal(NullSpaceQP.from_row(held).row, held)
        assert NullSpaceQP.from_row(held).row.strides == (8,)
    assert NullSpaceQP.from_row(row).row is row


@pytest.mark.parametrize("n", [1, 6, 7, 9])
def test_fields_cover_the_flat_array_in_order(n):
    record = np.arange(float(row_length(n)))
    for rows in (record, record[None]):
        parts = fields(rows)
        np.testing.assert_array_equal(np.concatenate([part.ravel() for part in parts]), record)
        assert [part.size for part in parts] == [6 * n, 6, n, n, n, n, 4, n]
    assert joints_of(len(record)) == n


def check_assembled(qp, rows):
    found, weight = qp.assembled(), np.repeat([qp.c0, qp.c1], 3)
    np.testing.assert_allclose(qp.P, qp.A.T @ (weight[:, None] * qp.A) + qp.regularization * np.eye(qp.n), atol=1e-14)
    np.testing.assert_allclose(qp.p, -qp.A.T @ (weight * qp.b) - qp.c2 * qp.pull, atol=1e-14)
    assert found.A.shape == (rows, qp.n)
    np.testing.assert_allclose(found.A, found.lift @ qp.A, atol=1e-14)
    np.testing.assert_allclose(found.b, found.lift @ qp.b, atol=1e-14)
    np.testing.assert_allclose(found.lift @ found.lift.T, np.eye(rows), atol=1e-14)
    assert not any(part.flags.writeable for part in found)


@settings(max_examples=100)
@given(
    seed=st.integers(0, 10_000), n=st.sampled_from([1, 2, 3, 7, 9]), rank=st.integers(0, 3),
    apart=st.sampled_from([0.0, 1e-9, 0.9e-7, 1.1e-7, 1e-5]), size=st.sampled_from([1e-3, 1.0, 1e3]),
)  # fmt: skip
def test_the_sixth_row_is_left_out_only_where_the_tool_is_rigid(seed, n, rank, apart, size):
    rng = np.random.default_rng(seed)
    J_tip, u = rng.normal(size=(3, n)), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    difference = u[:, :rank] @ rng.normal(size=(rank, n)) + apart * u[:, 2:] @ rng.normal(size=(1, n))
    ones = np.ones(n)
    qp = NullSpaceQP(size * J_tip, size * (J_tip - difference), np.ones(3), np.ones(3), ones, -ones, ones)
    left = qp.assembled()
    smallest, tied = np.linalg.svd(qp.J_tip - qp.J_wrist)[1][-1], 1e-7 * np.sqrt(2.0) * np.linalg.norm(qp.A)
    if n < 3 or smallest > 1.001 * tied:
        assert len(left.b) == 6
    elif rank == 2 and smallest < 0.999 * tied:
        assert len(left.b) == 5
    check_assembled(qp, len(left.b))
    if len(left.b) == 5:
        lost = np.cross(left.lift[3, 3:], left.lift[4, 3:]) @ (qp.J_tip - qp.J_wrist)
        assert np.linalg.norm(lost) <= 1.001 * tied


@pytest.mark.parametrize("axis", range(3))
def test_five_rows_are_left_for_a_rigid_tool_along_an_axis(qp, axis):
    difference = np.random.default_rng(3).normal(size=(3, 7)) * (np.arange(3) != axis)[:, None]
    check_assembled(changed(qp, J_wrist=qp.J_tip - difference), 5)


def test_assembled_with_argument_six_has_all_rows(qp):
    check_assembled(qp, 5)
    found = qp.assembled(6)
    np.testing.assert_array_equal(found.lift, np.eye(6))
    np.testing.assert_array_equal(found.A, qp.A)
