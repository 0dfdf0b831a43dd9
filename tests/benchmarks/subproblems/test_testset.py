"""The shipped sets: what their names say, certified, and what this program makes."""

import numpy as np
import pytest

from benchmarks.subproblems import certify
from benchmarks.subproblems.recipes import RECIPES
from moc_opt.qp.problem import compute_residuals
from moc_opt.study.testsets import CertificateError, TestSet, five_row_gap, straightened


@pytest.mark.parametrize("name", RECIPES)
def test_certified_answers_are_optimal_and_the_others_infeasible(name):
    """And every joint 0.05 rad/s faster would be seen to be wrong."""
    kept = TestSet.load(name)
    assert kept.rows.shape[0] == kept.x.shape[0] == kept.feasible.size > 0
    assert compute_residuals(kept.judged(), kept.x).verified(primal=1e-9)[kept.feasible].all()
    assert not compute_residuals(kept.judged(), kept.x + 0.05).verified()[kept.feasible].any()
    assert np.isnan(kept.x[~kept.feasible]).all()


@pytest.mark.parametrize("name", ["random", "joint-limits", "jumps", "inconsistent-1e-6"])
def test_a_set_is_made_again_as_it_is(name, robot):
    made, kept = certify.make(name, robot), TestSet.load(name)
    np.testing.assert_allclose(made.rows, kept.rows, rtol=1e-9, atol=1e-12, equal_nan=True)
    np.testing.assert_array_equal(made.feasible, kept.feasible)


def test_inconsistent_references_differ_along_the_shaft():
    for power in (-12, -8, -4):
        for qp in TestSet.load(f"inconsistent-1e{power}").problems()[:8]:
            assert np.linalg.norm(five_row_gap(qp, qp.b)) == pytest.approx(10.0**power, rel=1e-2)
            straight = straightened(qp)
            assert np.linalg.norm(five_row_gap(straight, straight.b)) < 1e-15
            np.testing.assert_allclose(straight.reduced().b, qp.reduced().b, atol=1e-15)


def test_the_names_keep_their_word():
    for name, rho in {"circle-rho0": 0.0, "circle": 1e-5}.items():
        assert TestSet.load(name).problems()[0].regularization == rho
    assert not TestSet.load("infeasible").feasible.all()
    jumps = TestSet.load("jumps").problems()
    np.testing.assert_array_equal(jumps[0].grad_mu, -jumps[1].grad_mu)
    steps = [np.abs(np.diff(TestSet.load(n).x, axis=0)).max() for n in ("circle", "jumps")]
    assert steps[0] < 0.3 < np.nan_to_num(steps[1], nan=1.0)


def test_a_set_survives_its_file(tmp_path):
    kept = TestSet.load("random")
    (tmp_path / "other.npz").write_bytes(kept.to_bytes())
    again = TestSet.load("other", tmp_path)
    np.testing.assert_array_equal(again.rows, kept.rows)
    with pytest.raises(CertificateError, match="make it with"):
        TestSet.load("none", tmp_path)
