"""The compiled residuals against their definition, whatever the answer, and what they leave to it."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.qp import residual_kernels as kernels
from moc_opt.qp.problem import compute_residuals, fields
from moc_opt.qp.residuals import FEASIBLE
from moc_opt.solvers.exact.solver import Exact
from tests.hard_problems import hard_problems, nearly_singular, rounded
from tests.problems import random_problem


def spoilt(rng, qp, x, kind):
    """An answer of one kind: right, near, far, on the line of self-motion, at a corner of the box, outside, or none."""
    line = np.linalg.svd(qp.A)[2][-1]
    return {
        "right": x, "near": x + 10.0 ** rng.uniform(-10, -3) * rng.normal(size=qp.n),
        "slid": x + rng.normal() * line, "corner": np.where(rng.uniform(size=qp.n) < 0.5, qp.lower, qp.upper),
        "outside": 3.0 * rng.normal(size=qp.n), "none": np.where(np.arange(qp.n) == 2, np.nan, x),
    }[kind]  # fmt: skip


KINDS = ("right", "near", "slid", "corner", "outside", "none")


def cases(seed, n=7, structured=True, each=40, change=lambda qp: qp):
    """Rows, answers and duals: every kind of answer, a third without duals, rho from 0 up, a tenth infeasible."""
    rng, found = np.random.default_rng(seed), []
    for k in range(each * len(KINDS)):
        qp = change(random_problem(
            rng, n, structured=structured, feasible=k % 10 != 3, regularization=float(rng.choice([0.0, 1e-5, 1e-2]))
        ))  # fmt: skip
        x, y, *_ = Exact().start(qp).solve(qp)
        x = np.where(np.isfinite(x), x, 0.5 * (qp.lower + qp.upper))
        y = np.full(6, np.nan) if k % 3 == 0 or y is None else y + (k % 2) * rng.normal(size=6)
        found.append((qp.row, spoilt(rng, qp, x, KINDS[k % len(KINDS)]), y))
    return [np.array(column) for column in zip(*found, strict=True)]


def assert_equal(found, expected):
    for name, mine, theirs in zip(expected._fields, found, expected, strict=True):
        np.testing.assert_array_equal(np.isinf(mine), np.isinf(theirs), err_msg=name)
        there = np.isfinite(theirs)
        np.testing.assert_allclose(mine[there], theirs[there], rtol=1e-9, atol=1e-11, err_msg=name)
    np.testing.assert_array_equal(found.verified(), expected.verified())


@pytest.mark.parametrize(("n", "structured"), [(7, True), (6, True), (7, False), (8, False)])
def test_equal_to_the_definition(n, structured):
    given = cases(n, n, structured)
    expected = compute_residuals(*given)
    assert 0.05 < expected.verified().mean() < 0.5  # both kinds of answers are there
    assert_equal(kernels.batch_residuals(*given), expected)


def judged(rows, x, y):
    found = np.full((len(x), 6), np.nan)
    return kernels.fill_residuals(rows, x, y, found), found


def test_all_of_one_freedom_is_compiled():
    done, found = judged(*cases(1))
    assert done.all()
    assert not np.isnan(found).any()


def test_what_has_several_freedoms_is_left_to_the_definition():
    done, _ = judged(*cases(2, 8, structured=False))
    x = cases(2, 8, structured=False)[1]
    np.testing.assert_array_equal(done, ~np.isfinite(x).all(axis=1))  # of no answer nothing is left to ask


@pytest.mark.parametrize("change", [partial(rounded, decimals=7), partial(nearly_singular, size=1e-9)])
def test_a_rank_that_is_not_plain_is_left_to_the_definition(change):
    given = cases(3, change=change, each=10)
    done, _ = judged(*given)
    assert not done[np.isfinite(given[1]).all(axis=1)].any()
    assert_equal(kernels.batch_residuals(*given), compute_residuals(*given))


def test_equal_at_the_edge_of_what_can_be_computed():
    """Rounded, nearly singular, huge and tiny problems; what is missed by rounding grows with the problem's numbers."""
    rng = np.random.default_rng(7)
    problems = [qp for qp in hard_problems() if np.abs(qp.row[: 9 * qp.n + 6]).max() < 1e4]
    x = np.array([np.clip(np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0], qp.lower, qp.upper) for qp in problems])
    rows, y = np.array([qp.row for qp in problems]), rng.normal(size=(len(x), 6))
    assert len(problems) > 80
    assert_equal(kernels.batch_residuals(rows, x, y), compute_residuals(rows, x, y))


@pytest.mark.parametrize("left", [0.0, 1e-11, 1e-7])
def test_a_gradient_that_the_self_motion_does_not_see(left):
    """Of the size of rounding on ker A, or just above it: the first asks for nothing, and every place is right."""
    rng, problems = np.random.default_rng(8), []
    for _ in range(20):
        qp = random_problem(rng, regularization=0.0)
        part = fields(row := np.array(qp.row))
        line = np.append(np.linalg.svd(qp.A[:, :6])[2][-1], 0.0)
        across = np.append(rng.normal(size=6), 0.0)
        part.grad_mu[:] = across - line * (line @ across) + left * line / np.abs(line).max()
        x = Exact().start(qp).solve(qp).x
        low, high = (np.where(line > 0.0, part.lower, part.upper) - x, np.where(line > 0.0, part.upper, part.lower) - x)
        step = np.divide(low, line, where=line != 0.0, out=np.full(7, -np.inf)).max()
        problems.append((row, x + 0.9 * step * line, np.full(6, np.nan)))
        problems.append((row, x + 0.9 * np.divide(high, line, where=line != 0.0, out=np.full(7, np.inf)).min() * line,
                         np.full(6, np.nan)))  # fmt: skip
    rows, x, y = (np.array(column) for column in zip(*problems, strict=True))
    found = kernels.batch_residuals(rows, x, y)
    assert judged(rows, x, y)[0].all()
    assert_equal(found, compute_residuals(rows, x, y))
    assert found.verified().all() == (left < 1e-9)


def test_a_joint_that_the_self_motion_leaves_alone_may_be_the_first():
    """Nothing of its unit vector is left beside the rows: the line begins at another joint."""
    rng = np.random.default_rng(9)
    for _ in range(20):
        A = np.vstack([np.eye(6)[0], rng.normal(size=(4, 6)) * np.r_[0.0, np.ones(5)], np.zeros(6)])
        A[5] = A[1] - 2.0 * A[2]
        Q, z = np.empty((5, 6)), np.empty(6)
        assert kernels.row_space(A, 6, Q, z, np.empty((6, 6)))
        np.testing.assert_allclose(A @ z, 0.0, atol=1e-13)
        assert np.linalg.norm(z) == pytest.approx(1.0)


def test_ticks_without_a_subproblem():
    """Rows of zeros, as a trace has them after a stop, beside sound ones."""
    rows, x, y = cases(5, each=2)
    rows[::2], x[::2], y[::2] = 0.0, np.nan, np.nan
    assert_equal(kernels.batch_residuals(rows, x, y), compute_residuals(rows, x, y))
    assert all(len(figure) == 0 for figure in kernels.batch_residuals(rows[:0], x[:0], y[:0]))


@given(
    seed=st.integers(0, 10**6),
    gap=st.one_of(st.just(0.0), *(st.floats(*ends) for ends in ((-5.0, -1.1), (-0.9, -0.01), (0.01, 0.9), (1.1, 5.0)))),
)
@settings(max_examples=60)
def test_a_box_that_the_line_only_touches(seed, gap):
    """Two bounds that leave an interval of some 1e-6 rad/s, one point, or nothing, by ``gap`` times the tolerance."""
    rng = np.random.default_rng(seed)
    qp = random_problem(rng)
    x, part = Exact().start(qp).solve(qp).x, fields(row := np.array(qp.row))
    part.lower[:6], part.upper[:6] = -10.0, 10.0  # nothing but the two bounds below; the last joint is idle
    line = np.linalg.svd(qp.A[:, :6])[2][-1]
    for j, side in zip(np.argsort(np.abs(line))[:-3:-1], (1.0, -1.0), strict=True):
        bound = part.upper if side * line[j] > 0.0 else part.lower
        bound[j] = x[j] - np.sign(line[j]) * side * gap * FEASIBLE
    one = row[None], x[None], np.full((1, 6), np.nan)
    assert judged(*one)[0].all()
    found, expected = kernels.batch_residuals(*one), compute_residuals(*one)
    # The share of so short an interval is known to no more than rounding of its ends over its length.
    np.testing.assert_allclose(found.loss, expected.loss, atol=1e-6)
    assert_equal(found._replace(loss=expected.loss), expected)
    assert np.isinf(expected.distance[0]) == (gap > 1.0)
    assert gap < 0.0 or expected.verified()[0] == (gap < 1.0)
