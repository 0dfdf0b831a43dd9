"""`Faulty` fails on purpose, at the ticks that its seed determines."""

import numpy as np
import pytest

from moc_opt.solvers import Status, create
from moc_opt.solvers.faulty import KINDS, Faulty, InjectedFault, draw
from tests.problems import smooth_sequence

PROBLEMS = smooth_sequence(np.random.default_rng(0), 80)


def is_wrong(kind, qp, answer):
    if kind == "fail":
        return answer.status is Status.NUMERICAL and np.isnan(answer.x).all()
    if kind == "rig":
        return (answer.x == 50.0).all() and qp.residuals(answer.x).primal < 1e-9  # the fault has rewritten the problem
    if kind == "malformed":
        return answer.y.dtype == complex
    if answer.status is not Status.SOLVED:
        return False
    if kind == "nan":
        return np.isnan(answer.x).all()
    if kind == "outside":
        return (answer.x > qp.upper).any()
    return qp.residuals(answer.x).primal < 1e-9 and not qp.residuals(answer.x).verified()  # a false SOLVED


@pytest.mark.parametrize("kind", KINDS)
def test_exactly_the_drawn_ticks_are_wrong(kind):
    """On a faulty tick, the inner solver is called only if the kind is "malformed"."""
    inner = create("rnn")  # its answers depend on all earlier problems
    session, honest = Faulty(inner, kind, rate=0.3, seed=4).start(PROBLEMS[0]), inner.start(PROBLEMS[0])
    corrupted = draw(4, 0.3, len(PROBLEMS))
    assert 0.2 < corrupted.mean() < 0.4
    for qp, bad in zip(PROBLEMS, corrupted, strict=True):
        shown = qp.copy()
        if bad and kind == "malformed":
            honest.solve(qp)
        if bad and kind == "raise":
            with pytest.raises(InjectedFault):
                session.solve(shown)
        elif bad:
            assert is_wrong(kind, shown, session.solve(shown))
        else:
            np.testing.assert_array_equal(session.solve(shown).x, honest.solve(qp).x)
    assert session.faults == corrupted.sum()


def test_a_seed_always_draws_the_same_ticks():
    long = draw(3, 0.2, 1000)
    np.testing.assert_array_equal(long[:400], draw(3, 0.2, 400))
    assert (draw(4, 0.2, 1000) != long).any()
    assert [draw(3, rate, 100).mean() for rate in (0.0, 1.0)] == [0.0, 1.0]
