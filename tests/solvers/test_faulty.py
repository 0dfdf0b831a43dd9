"""A solver that fails on purpose: at the ticks that were drawn, and in the way that was asked for."""

import numpy as np
import pytest

from moc_opt.errors import SolverError
from moc_opt.qp.problem import NullSpaceQP, compute_residuals
from moc_opt.scenario import Scenario, run
from moc_opt.solvers import create
from moc_opt.solvers.base import Status
from moc_opt.solvers.exact import Exact
from moc_opt.solvers.faulty import KINDS, Faulty, InjectedFault, draw


@pytest.fixture(scope="module")
def problems():
    trace = run(Scenario(control={"preset": "tuned"}, duration_s=0.4, bound_samples=0, judge=False))
    return [NullSpaceQP.from_row(np.array(row)) for row in trace.subproblem]


def answers(session, problems):
    """What a session says; None where it raised."""
    found = []
    for qp in problems:
        try:
            found.append(session.solve(qp))
        except InjectedFault:
            found.append(None)
    return found


def is_wrong(kind, qp, answer):
    if kind == "raise":
        return answer is None
    if kind == "fail":
        return answer.status is Status.NUMERICAL and np.isnan(answer.x).all()
    if kind == "nan":
        return answer.status is Status.SOLVED and np.isnan(answer.x).all()
    if kind == "outside":
        return answer.status is Status.SOLVED and (answer.x > qp.upper).any()
    if kind == "rig":
        return (answer.x == 50.0).all() and qp.residuals(answer.x).primal < 1e-9  # by its own copy of the problem
    if kind == "malformed":
        return answer.y.dtype == complex
    found = compute_residuals(qp.row[None], answer.x[None])  # a lie
    return answer.status is Status.SOLVED and found.primal[0] < 1e-9 and not found.verified()[0]


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_at_the_drawn_ticks_and_right_at_the_others(kind, problems):
    solver = Faulty(Exact(), kind, rate=0.3, seed=4)
    session = solver.start(problems[0])
    corrupted = solver.fault_mask(len(problems))
    assert 0.2 < corrupted.mean() < 0.4
    right = answers(Exact().start(problems[0]), problems)
    shown = [qp.copy() for qp in problems]
    for qp, bad, mine, honest in zip(shown, corrupted, answers(session, shown), right, strict=True):
        if bad:
            assert is_wrong(kind, qp, mine)
        else:
            np.testing.assert_array_equal(mine.x, honest.x)
    assert session.faults == corrupted.sum()


def test_the_draw_belongs_to_the_seed_and_grows():
    long, short = draw(3, 0.2, 1000), draw(3, 0.2, 400)
    np.testing.assert_array_equal(long[:400], short)
    assert (draw(4, 0.2, 1000) != long).any()
    assert not draw(3, 0.0, 100).any()
    assert draw(3, 1.0, 100).all()


def test_the_solver_inside_keeps_its_memory_to_itself(problems):
    """A network that is not asked at a tick goes on from where it was: its answers are not mixed with lies."""
    clean, corrupted = (
        create("rnn").start(problems[0]),
        Faulty(create("rnn"), "lie", rate=0.5).start(problems[0]),
    )
    hit = Faulty(create("rnn"), "lie", rate=0.5).fault_mask(len(problems))
    for qp, bad in zip(problems, hit, strict=True):
        mine = corrupted.solve(qp)
        if not bad:
            np.testing.assert_array_equal(mine.x, clean.solve(qp).x)


@pytest.mark.parametrize("changes", [{"kind": "lei"}, {"rate": -0.1}, {"rate": 1.5}, {"rate": float("nan")}])
def test_wrong_settings_name_the_field(changes):
    with pytest.raises(SolverError, match=next(iter(changes))):
        Faulty(Exact(), **{"kind": "lie", **changes})
