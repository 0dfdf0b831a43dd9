"""The compiled assembly says what the plain numpy of the subproblem says."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.qp.equalities import equalities, expand
from moc_opt.qp.problem import NullSpaceQP
from tests.problems import random_problem


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), n=st.sampled_from([6, 7, 9]), structured=st.booleans())
def test_kernel_equals_numpy(seed, n, structured):
    plain = random_problem(np.random.default_rng(seed), n, structured=structured)
    fast = NullSpaceQP.from_row(np.array(plain.row))
    expand(fast)
    np.testing.assert_allclose(fast.P, plain.P, atol=1e-15)
    np.testing.assert_allclose(fast.p, plain.p, atol=1e-15)
    for ours, theirs in zip(fast.reduced(), plain.reduced(), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_six_rows_where_nothing_is_tied():
    rng = np.random.default_rng(3)
    J = rng.normal(size=(2, 3, 7))
    qp = NullSpaceQP(J[0], J[1], np.zeros(3), np.zeros(3), np.ones(7), -np.ones(7), np.ones(7))
    assert equalities(qp, 5).A.shape == (6, 7)
    np.testing.assert_array_equal(equalities(qp, 6).A, qp.A)


def test_what_is_handed_out_is_read_only():
    qp = random_problem(np.random.default_rng(4))
    expand(qp)
    assert not any(a.flags.writeable for a in (qp.P, qp.p, *qp.reduced()))
