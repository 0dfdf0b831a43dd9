"""The compiled assembly says what the plain form of the subproblem says."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from tests.problems import random_problem


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


def test_six_rows_on_request():
    qp = random_problem(np.random.default_rng(4))
    found = assembled(qp, 6)
    np.testing.assert_array_equal(found.A, qp.A)
    np.testing.assert_array_equal(found.lift, np.eye(6))


def test_nothing_is_written_into_the_problem_and_all_is_read_only():
    qp = random_problem(np.random.default_rng(4))
    before = dict(qp.__dict__)
    found = assembled(qp)
    assert qp.__dict__.keys() - before.keys() <= {"fields"}
    assert not any(a.flags.writeable for a in (*found, qp.P, qp.p, *qp.reduced()))
