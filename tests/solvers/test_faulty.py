"""A solver that fails on purpose: at the ticks that were drawn, and in the way that was asked for."""

import numpy as np
import pytest

from moc_opt.errors import SolverError
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario, run
from moc_opt.solvers import Status, create
from moc_opt.solvers.exact import Exact
from moc_opt.solvers.faulty import KINDS, Faulty, InjectedFault, draw


@pytest.fixture(scope="module")
def problems():
    trace = run(Scenario(control={"preset": "tuned"}, duration_s=0.4, bound_samples=0, judge=False))
    return [NullSpaceQP.from_row(np.array(row)) for row in trace.subproblem]


def is_wrong(kind, qp, answer):
    if kind == "fail":
        return answer.status is Status.NUMERICAL and np.isnan(answer.x).all()
    if kind == "rig":
        return (answer.x == 50.0).all() and qp.residuals(answer.x).primal < 1e-9  # by its own copy of the problem
    if kind == "malformed":
        return answer.y.dtype == complex
    if answer.status is not Status.SOLVED:
        return False
    if kind == "nan":
        return np.isnan(answer.x).all()
    if kind == "outside":
        return (answer.x > qp.upper).any()
    return qp.residuals(answer.x).primal < 1e-9 and not qp.residuals(answer.x).verified()  # a lie


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_at_the_drawn_ticks_and_right_at_the_others(kind, problems):
    session, honest = Faulty(Exact(), kind, rate=0.3, seed=4).start(problems[0]), Exact().start(problems[0])
    corrupted = draw(4, 0.3, len(problems))
    assert 0.2 < corrupted.mean() < 0.4
    for qp, bad in zip(problems, corrupted, strict=True):
        shown = qp.copy()
        if bad and kind == "raise":
            with pytest.raises(InjectedFault):
                session.solve(shown)
        elif bad:
            assert is_wrong(kind, shown, session.solve(shown))
        else:
            np.testing.assert_array_equal(session.solve(shown).x, honest.solve(qp).x)
    assert session.faults == corrupted.sum()


def test_the_draw_belongs_to_the_seed_and_grows():
    long, short = draw(3, 0.2, 1000), draw(3, 0.2, 400)
    np.testing.assert_array_equal(long[:400], short)
    assert (draw(4, 0.2, 1000) != long).any()
    assert not draw(3, 0.0, 100).any()
    assert draw(3, 1.0, 100).all()


def test_the_solver_inside_keeps_its_memory_to_itself(problems):
    """A network that is not asked at a tick goes on from where it was: its answers are not mixed with lies."""
    clean, corrupted = create("rnn").start(problems[0]), Faulty(create("rnn"), "lie", rate=0.5).start(problems[0])
    for qp, bad in zip(problems, draw(0, 0.5, len(problems)), strict=True):
        mine = corrupted.solve(qp)
        if not bad:
            np.testing.assert_array_equal(mine.x, clean.solve(qp).x)


@pytest.mark.parametrize("changes", [{"kind": "lei"}, {"rate": -0.1}, {"rate": 1.5}, {"rate": float("nan")}])
def test_wrong_settings_name_the_field(changes):
    with pytest.raises(SolverError, match=next(iter(changes))):
        Faulty(Exact(), **{"kind": "lie", **changes})
