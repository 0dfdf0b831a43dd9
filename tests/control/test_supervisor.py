"""The supervisor of the third level: what is refused, what stands in, and what never changes because of it."""

import itertools
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.null_space import null_space
from moc_opt.control.solution_check import MOST_ITERATIONS, answer_residuals, received
from moc_opt.control.supervisor import Fault, Supervisor, SupervisorSettings, Unanswered
from moc_opt.errors import ControlError
from moc_opt.qp.problem import NullSpaceQP, compute_residuals, fields
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.solvers import available
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.exact.solver import Exact
from moc_opt.solvers.faulty import KINDS, Faulty
from tests.problems import random_problem
from tests.wrong_answers import wrong_corners

QUICK = {"bound_samples": 0, "duration_s": 0.4}


class Scripted:
    """A session that gives the answers it was given; an exception among them is raised."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def solve(self, qp):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


@pytest.fixture(scope="module")
def recorded():
    """Subproblems of closed-loop runs, with and without regularization, far from and near the optimum."""
    rows = []
    for control in ({"preset": "tuned"}, {}, {"preset": "paper"}):
        trace = run(Scenario(control=control, **{**QUICK, "duration_s": 3.0}, judge=False))
        rows.append(trace.subproblem[::25])
    return np.concatenate(rows)


@pytest.fixture(scope="module")
def qp(recorded):
    return NullSpaceQP.from_row(np.array(recorded[10]))


@pytest.fixture(scope="module")
def Z(qp):
    return null_space(qp.A)


def solved(qp):
    return Exact().start(qp).solve(qp)


def opposite(qp):
    row = np.array(qp.row)
    fields(row).grad_mu[:] *= -1.0
    return solved(NullSpaceQP.from_row(row))


def supervisor(fallback="damping", times=None, **changes):
    return Supervisor(SupervisorSettings(**changes), fallback, 7, None if times is None else iter(times))


def test_a_good_answer_is_followed_and_copied(qp, Z):
    good = solved(qp)
    mine = supervisor()
    solution, x = mine.solve(Scripted(good), qp, Z)
    assert mine.fault is Fault.NONE
    np.testing.assert_array_equal(solution.x, good.x)
    np.testing.assert_array_equal(solution.y, good.y)
    np.testing.assert_array_equal(x, good.x)
    assert not np.shares_memory(solution.x, good.x)
    assert not np.shares_memory(solution.y, good.y)
    assert not np.shares_memory(x, good.x)
    assert mine.counts == {}


class LyingCount(np.int64):
    """Compares as small, and counts as 2^70, which no trace holds."""

    def __le__(self, other):
        return True

    def __int__(self):
        return 2**70


def wrong_answers(qp):
    x = solved(qp).x
    return {
        Fault.FAILED: no_answer(7, Status.NUMERICAL),
        Fault.RAISED: RuntimeError("from inside a solver"),
        Fault.NOT_FINITE: Solution(np.where(np.arange(7) == 3, np.nan, x), None, Status.SOLVED),
        Fault.MALFORMED: Solution(x, np.zeros(6, complex), Status.SOLVED),
        Fault.OUTSIDE: Solution(x + 0.5, None, Status.SOLVED),
        Fault.FALSE_OPTIMUM: opposite(qp),
        Fault.INFEASIBLE: no_answer(7, Status.INFEASIBLE),
        Fault.LOST: Unanswered(Fault.LOST, "its process ended"),
    }


@pytest.mark.parametrize("fault", [f for f in Fault if f not in (Fault.NONE, Fault.LATE)])
def test_each_fault_has_its_name_and_is_counted(fault, qp, Z):
    mine = supervisor()
    mine.solve(Scripted(solved(qp)), qp, Z)
    _, x = mine.solve(Scripted(wrong_answers(qp)[fault]), qp, Z)
    assert mine.fault is fault
    assert mine.counts == {fault.label: 1}
    # the last good answer is held, but an infeasible subproblem is answered by the fallback
    np.testing.assert_array_equal(x, np.zeros(7) if fault is Fault.INFEASIBLE else solved(qp).x)


@pytest.mark.parametrize("late", ["hold", "zero", "iterate"])
def test_an_answer_that_is_not_there_in_time_is_never_followed(late, qp, Z):
    mine = supervisor(late=late)
    mine.solve(Scripted(solved(qp)), qp, Z)
    solution, x = mine.solve(Scripted(Unanswered(Fault.LATE, "nothing after 700 us")), qp, Z)
    assert (mine.fault, solution.status) == (Fault.LATE, Status.TIME_LIMIT)
    assert mine.firsts["late"].text == "nothing after 700 us"
    np.testing.assert_array_equal(x, np.zeros(7) if late == "zero" else solved(qp).x)


@pytest.mark.parametrize("hold", [0, 1, 4])
def test_held_for_some_ticks_and_damped_from_then_on(hold, qp, Z):
    mine = supervisor(hold_ticks=hold)
    wrong = no_answer(7, Status.NUMERICAL)
    mine.solve(Scripted(solved(qp)), qp, Z)
    held = [bool(mine.solve(Scripted(wrong), qp, Z)[1].any()) for _ in range(hold + 3)]
    assert held == [True] * hold + [False] * 3
    mine.solve(Scripted(solved(qp)), qp, Z)
    assert mine.solve(Scripted(wrong), qp, Z)[1].any() == (hold > 0)  # a good answer starts the count anew


def near_a_limit(qp, Z):
    """The same tick where the box cuts off the shortest motion, but not all: joint 2 may do half of what it wants."""
    row = np.array(qp.row)
    shortest = np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0]
    part = fields(row)
    (part.lower if shortest[1] < 0.0 else part.upper)[1] = 0.5 * shortest[1]
    return NullSpaceQP.from_row(row), shortest


def test_damping_keeps_off_the_limits(recorded):
    """Once holding is over the elbow moves as far as the box asks for, and no further; or not at all, if told so."""
    rows = [NullSpaceQP.from_row(np.array(row)) for row in recorded]
    cut = [(*near_a_limit(qp, null_space(qp.A)), null_space(qp.A)) for qp in rows]
    # of those that have a way out, the one where the box cuts most off
    some = [entry for entry in cut if solved(entry[0]).status is Status.SOLVED]
    tight, shortest, Z = max(some, key=lambda entry: abs(entry[1][1]))
    assert abs(shortest[1]) > 1e-3
    wrong = no_answer(7, Status.NUMERICAL)
    _, x = supervisor(hold_ticks=0).solve(Scripted(wrong), tight, Z)
    np.testing.assert_allclose(tight.A @ x, 0.0, atol=1e-12)  # tip and wrist do not notice
    assert shortest[1] + x[1] == pytest.approx(0.5 * shortest[1], abs=1e-6)
    assert (shortest + x >= tight.lower - 1e-6).all()
    assert (shortest + x <= tight.upper + 1e-6).all()
    _, bare = supervisor(hold_ticks=0, keep_off_limits=False).solve(Scripted(wrong), tight, Z)
    assert not bare.any()
    _, empty = supervisor(hold_ticks=0).solve(Scripted(no_answer(7, Status.INFEASIBLE)), tight, Z)
    assert not empty.any()


def test_a_solver_that_never_answers_costs_no_joint_its_room(robot):
    """This start leads joint 6 to its limit where nothing but damping is left."""
    faults = {"solver": "nan", "solver_share": 1.0}
    base = Scenario(
        control={"preset": "tuned"}, start={"swivel": "random"}, faults=faults, bound_samples=0, judge=False
    )
    kept = run(base)
    assert not kept.limited.any()
    room = np.minimum(robot.q_max - kept.q_rad, kept.q_rad - robot.q_min).min()
    assert 0.15 < room < 0.2
    bare = run(base.change(control={"supervisor": {"keep_off_limits": False}}))
    assert bare.limited.any()
    assert kept.rcm_error_m.mean() < 0.9 * bare.rcm_error_m.mean()
    assert kept.tip_error_m.max() < 0.2 * bare.tip_error_m.max()


def test_nothing_to_hold_before_the_first_good_answer(qp, Z):
    mine = supervisor()
    assert not mine.solve(Scripted(no_answer(7, Status.NUMERICAL)), qp, Z)[1].any()


def test_what_was_held_cannot_be_changed_from_outside(qp, Z):
    good = solved(qp)
    mine = supervisor()
    mine.solve(Scripted(Solution(x := np.array(good.x), None, Status.SOLVED)), qp, Z)
    x[:] = 9.0  # a solver that writes its next answer into the same memory
    np.testing.assert_array_equal(mine.solve(Scripted(RuntimeError()), qp, Z)[1], good.x)


@pytest.mark.parametrize(
    "answer",
    [
        None, 3.0, (1, 2), "x", np.zeros(7), Solution([0.0] * 7, None, Status.SOLVED),
        Solution(np.zeros(6), None, Status.SOLVED), Solution(np.zeros((7, 1)), None, Status.SOLVED),
        Solution(np.zeros(7, dtype=complex), None, Status.SOLVED), Solution(np.zeros(7), None, "solved"),
        Solution(None, None, Status.SOLVED),
    ],
)  # fmt: skip
def test_what_is_no_solution_at_all_is_a_fault(answer, qp, Z):
    mine = supervisor()
    solution, x = mine.solve(Scripted(answer), qp, Z)
    assert mine.fault is Fault.MALFORMED
    assert solution.x.shape == (7,)
    assert not x.any()


def test_an_answer_with_gaps_in_memory_is_an_answer(qp, Z):
    good = solved(qp)
    wide = np.full((7, 3), 5.0)
    wide[:, 1] = good.x
    mine = supervisor()
    solution, x = mine.solve(Scripted(Solution(wide[:, 1], good.y, Status.SOLVED)), qp, Z)
    assert mine.fault is Fault.NONE
    np.testing.assert_array_equal(x, good.x)
    np.testing.assert_array_equal(solution.x, good.x)


class Liar:
    """Says that it is of another class."""

    __class__ = Solution


class Shy(tuple):
    """A Solution that raises where it is read."""

    __class__ = Solution

    def __iter__(self):
        raise RuntimeError("do not look")


class Odd(np.ndarray):
    """An array whose copies may do anything."""


BAD_DUALS = [np.zeros(5), np.zeros((6, 1)), [0.0] * 6, np.zeros(6, complex), np.zeros(6, "f4"), np.array(["a"] * 6), 3]
BAD_COUNTS = ["many", 2.5, None, -1, MOST_ITERATIONS + 1, 10**400, float("nan"), True]


@pytest.mark.parametrize("y", BAD_DUALS, ids=str)
def test_duals_of_another_form_are_a_fault(y, qp, Z):
    """They are asked for with that form; a trace could not hold them, and the judge could not read them."""
    mine = supervisor()
    good = solved(qp)
    solution, x = mine.solve(Scripted(Solution(good.x, y, Status.SOLVED)), qp, Z)
    assert mine.fault is Fault.MALFORMED
    assert mine.firsts["malformed"].text.startswith("y ")
    assert solution.y is None
    np.testing.assert_array_equal(x, np.zeros(7))


@pytest.mark.parametrize("iterations", BAD_COUNTS, ids=lambda given: str(given)[:10])
def test_a_count_that_no_trace_can_hold_is_a_fault(iterations, qp, Z):
    mine = supervisor()
    solution, _ = mine.solve(Scripted(Solution(solved(qp).x, None, Status.SOLVED, iterations)), qp, Z)
    assert mine.fault is Fault.MALFORMED
    assert mine.firsts["malformed"].text.startswith("iterations ")
    assert solution.iterations == 0
    for right in (0, np.int64(7), MOST_ITERATIONS):
        mine.solve(Scripted(Solution(solved(qp).x, None, Status.SOLVED, right)), qp, Z)
        assert mine.fault is Fault.NONE


@pytest.mark.parametrize("answer", [Liar(), Shy((1, 2)), (1, 2), object(), np.zeros(7)], ids=lambda a: type(a).__name__)
def test_whatever_comes_back_something_stands_in(answer, qp, Z):
    mine = supervisor()
    _, x = mine.solve(Scripted(answer), qp, Z)
    assert mine.fault in (Fault.MALFORMED, Fault.RAISED)
    np.testing.assert_array_equal(x, np.zeros(7))


def test_answers_that_lie_oddly_in_memory_are_copied(qp):
    good = solved(qp)
    for x in (good.x, good.x[::-1].copy()[::-1], good.x.astype(">f8").astype("<f8")):
        found, wrong = received(Solution(x, good.y, Status.SOLVED, 3), 7)
        assert wrong == ""
        np.testing.assert_array_equal(found.x, good.x)
        np.testing.assert_array_equal(found.y, good.y)
        assert found.x.strides == (8,)
        assert not np.shares_memory(found.x, x)
    for x in (good.x[:6], good.x.astype(np.float32), list(good.x), np.r_[good.x, 0.0], None, good.x.view(Odd)):
        found, wrong = received(Solution(x, None, Status.SOLVED, 1), 7)
        assert wrong.startswith("x ")
        assert np.isnan(found.x).tolist() == [True] * 7


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "solve returned a NoneType: return a Solution"),
        (Solution(np.zeros(7), None, "great"), "the status is a str: give a Status"),
        (Solution([0.0] * 7, None, Status.SOLVED), "x is a list: give an array of float64"),
        (Solution(np.zeros(7, np.float32), None, Status.SOLVED), "x is an array of float32"),
        (Solution(np.zeros(3), None, Status.SOLVED), "x has shape (3,): give (7,)"),
        (Solution(np.zeros(7), np.zeros(5), Status.SOLVED), "y has shape (5,): give (6,)"),
        (Solution(np.zeros(7), None, Status.SOLVED, -3), "iterations is out of range"),
        (Solution(np.zeros(7), None, Status.SOLVED, LyingCount(3)), "iterations is a LyingCount"),
    ],
)
def test_an_answer_of_a_wrong_form_is_told_from_a_solver_in_trouble(answer, words, qp, Z):
    mine = supervisor()
    mine.solve(Scripted(answer), qp, Z)
    (first,) = mine.firsts.values()
    assert words in first.text


@pytest.mark.parametrize("raises", [False, True])
def test_a_solver_that_lowers_the_recursion_limit_harms_no_one_but_itself(raises, qp, Z):
    """What runs after it would end in a RecursionError that no check catches."""
    before, good = sys.getrecursionlimit(), solved(qp)

    class Shallow:
        def solve(self, qp):
            depth = 0
            while True:
                try:
                    sys.setrecursionlimit(depth := depth + 1)
                except RecursionError:  # too low for where this stands
                    continue
                break
            if raises:
                raise RuntimeError("out of depth")
            return good

    mine = supervisor()
    try:
        mine.solve(Shallow(), qp, Z)
        assert sys.getrecursionlimit() == before
        assert mine.counts == ({"raised": 1} if raises else {})
    finally:
        sys.setrecursionlimit(before)


def test_a_solver_that_exits_does_not_end_the_run(qp, Z):
    class Exits:
        def solve(self, qp):
            raise SystemExit("enough")

    mine = supervisor()
    _, x = mine.solve(Exits(), qp, Z)
    assert mine.fault is Fault.RAISED
    assert mine.firsts["raised"].text == "SystemExit: enough"
    assert np.isfinite(x).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(7))
def test_what_is_not_finite_is_told_by_nan(bad, place, qp, Z):
    x = np.zeros(7)
    x[place] = bad
    assert np.isnan(answer_residuals(qp.row, 7, Z, x)).all()


class Grader:
    """Makes the problem writable and easy, and answers that one; then writes on, into what it has handed over."""

    def __init__(self):
        self.x, self.given = np.full(7, 50.0), None

    def observe(self, v):
        v.setflags(write=True)
        v[:] = 1e3

    def solve(self, qp):
        for array in (qp.row, qp.row if qp.row.base is None else qp.row.base):
            array.setflags(write=True)
            part = fields(array)
            part.A[:], part.b[:], part.lower[:], part.upper[:] = 0.0, 0.0, -1e3, 1e3
        return Solution(self.x, None, Status.SOLVED)


def test_a_solver_cannot_grade_itself(qp, Z):
    before, v = np.array(qp.row), np.zeros(7)
    mine = supervisor()
    _, x = mine.solve(Grader(), qp, Z, v)
    assert mine.fault is Fault.OUTSIDE
    np.testing.assert_array_equal(x, np.zeros(7))
    np.testing.assert_array_equal(qp.row, before)
    np.testing.assert_array_equal(v, 0.0)


def test_what_a_solver_writes_after_its_answer_changes_nothing(qp, Z):
    good = solved(qp)
    handed = Solution(good.x.copy(), good.y.copy(), Status.SOLVED)
    mine = supervisor()
    solution, x = mine.solve(Scripted(handed), qp, Z)
    handed.x[:], handed.y[:] = 50.0, np.nan
    np.testing.assert_array_equal(solution.x, good.x)
    np.testing.assert_array_equal(solution.y, good.y)
    np.testing.assert_array_equal(x, good.x)


@given(
    st.sampled_from(list(Status)), st.integers(0, 2**32 - 1), st.floats(1e-4, 1e3),
    st.sampled_from(["hold", "zero", "iterate"]),
)
@settings(max_examples=60, deadline=None)
def test_no_claim_gets_an_answer_past_the_equalities(status, seed, size, late):
    """Whatever status stands on it, and late or not: what is followed keeps A x = b and the box within the limits."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, 7, regularization=1e-5)
    x = rng.normal(size=7) * size
    limits = SupervisorSettings()
    mine = supervisor(times=[rng.choice([1.0, 1e6])], budget_us=1e3, late=late)
    _, followed = mine.solve(Scripted(Solution(x, None, status)), problem, null_space(problem.A))
    if np.array_equal(followed, x):
        most = limits.primal_limit if status is Status.SOLVED else limits.box_limit
        assert np.abs(problem.A @ x - problem.b).max() <= most
        assert max((problem.lower - x).max(), (x - problem.upper).max()) <= most


@pytest.mark.parametrize("error", [SystemExit("enough"), GeneratorExit(), RuntimeError("no"), MemoryError()], ids=repr)
@pytest.mark.parametrize("where", ["observe", "solve"])
def test_whatever_a_session_raises_is_counted(error, where, qp, Z):
    class Raises:
        def observe(self, v):
            if where == "observe":
                raise error

        def solve(self, qp):
            raise error

    mine = supervisor()
    _, x = mine.solve(Raises(), qp, Z, np.zeros(7))
    assert mine.fault is Fault.RAISED
    assert mine.firsts["raised"].text.startswith(type(error).__name__)
    assert np.isfinite(x).all()


@pytest.mark.parametrize("linked", ["cause", "context"])
def test_a_users_interrupt_passes_under_an_error_of_a_library(linked, qp, Z):
    """As CasADi's: "returned a result with an exception set"."""

    class Hidden:
        def solve(self, qp):
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as error:
                if linked == "cause":
                    raise SystemError("a result with an exception set") from error
                raise SystemError("a result with an exception set")  # noqa: B904 - the context is meant

    with pytest.raises(KeyboardInterrupt):
        supervisor().solve(Hidden(), qp, Z)


def test_an_error_whose_causes_are_a_ring_is_a_fault(qp, Z):
    class Ring:
        def solve(self, qp):
            error = RuntimeError("one")
            error.__cause__ = ValueError("other")
            error.__cause__.__cause__ = error
            raise error

    mine = supervisor()
    mine.solve(Ring(), qp, Z)
    assert mine.fault is Fault.RAISED


@pytest.mark.parametrize("where", ["observe", "solve"])
def test_a_users_interrupt_passes(where, qp, Z):
    class Interrupted:
        def observe(self, v):
            if where == "observe":
                raise KeyboardInterrupt

        def solve(self, qp):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        supervisor().solve(Interrupted(), qp, Z, np.zeros(7))


def test_a_lie_is_seen_at_every_tick_where_it_is_one(recorded):
    """The optimum of the opposite gradient, claimed: refused, or verified as the optimum by the judge.

    The two overlap: near a maximum of mu the supervisor is the stricter one of them.
    """
    lies = 0
    for row in recorded:
        qp = NullSpaceQP.from_row(np.array(row))
        lie = opposite(qp)
        if lie.status is not Status.SOLVED:
            continue
        mine = supervisor()
        mine.solve(Scripted(lie), qp, null_space(qp.A))
        seen = mine.fault is Fault.FALSE_OPTIMUM
        right = bool(compute_residuals(row[None], lie.x[None]).verified()[0])
        assert seen or right, (mine.fault, answer_residuals(qp.row, 7, null_space(qp.A), lie.x))
        lies += seen
    assert lies > 100


@settings(max_examples=60)
@given(place=st.floats(0.0, 0.49), k=st.integers(0, 10**6))
def test_a_claim_is_never_both_verified_and_refused(recorded, place, k):
    """Nearer to the optimum than to its opposite: what the judge verifies, the supervisor takes."""
    row = recorded[k % len(recorded)]
    qp = NullSpaceQP.from_row(np.array(row))
    one, other = solved(qp), opposite(qp)
    if one.status is not Status.SOLVED:
        return
    x = (1.0 - place) * one.x + place * other.x
    mine = supervisor()
    mine.solve(Scripted(Solution(x, None, Status.SOLVED)), qp, null_space(qp.A))
    if compute_residuals(row[None], x[None]).verified()[0]:
        assert mine.fault is Fault.NONE
    if place == 0.0:
        assert mine.fault is Fault.NONE


@settings(max_examples=200)
@given(
    seed=st.integers(0, 10**6), rest=st.floats(-12.0, 0.0), off=st.floats(-9.0, -1.0), rho=st.sampled_from([1e-5, 1e-3])
)  # fmt: skip
def test_what_is_verified_is_taken_where_a_course_rests(seed, rest, off, rho):
    """A followed course has (rho/c2) x_d in the place of the gradient, and x_d is nearly zero where it rests."""
    rng = np.random.default_rng(seed)
    begun = random_problem(rng, regularization=rho)
    qp = NullSpaceQP(
        begun.J_tip, begun.J_wrist, begun.b[:3], begun.b[3:], rho / begun.c2 * 10.0**rest * rng.normal(size=7),
        begun.lower, begun.upper, c2=begun.c2, regularization=rho, q=begun.q,
    )  # fmt: skip
    Zs, exact = null_space(qp.A), solved(qp)
    assert exact.status is Status.SOLVED
    x = exact.x + 10.0**off * Zs.T @ rng.normal(size=len(Zs)) * (np.arange(7) < 6)
    found, mine = qp.residuals(x), supervisor()
    mine.solve(Scripted(Solution(x, None, Status.SOLVED)), qp, Zs)
    assert answer_residuals(qp.row, 7, Zs, x)[2] <= found.relative * (1.0 + 1e-6) + 1e-9
    if found.verified():
        assert mine.fault is Fault.NONE


def test_the_residuals_are_those_of_the_judge(recorded):
    rng = np.random.default_rng(3)
    for row in recorded[::7]:
        qp = NullSpaceQP.from_row(np.array(row))
        exact = solved(qp)
        if exact.status is not Status.SOLVED:
            continue
        Zs = null_space(qp.A)
        x = exact.x + 0.02 * Zs.T @ rng.normal(size=len(Zs)) * (np.arange(7) < 6)
        primal, outside, relative, off, _ = answer_residuals(qp.row, 7, Zs, x)
        found = compute_residuals(row[None], x[None])
        assert max(primal, outside) == pytest.approx(found.primal[0], abs=1e-12)
        assert relative <= found.relative[0] * (1 + 1e-6) + 1e-9  # one of the directions the judge tries
        assert off <= np.linalg.norm(x - exact.x) + 1e-6
        assert answer_residuals(qp.row, 7, Zs, exact.x)[2:4] == pytest.approx((0.0, 0.0), abs=1e-9)


def along_the_line(qp, Z, x):
    """What `answer_residuals` says of x, by search: a bounded minimizer for the optima, bisection for the residual."""
    d = Z.T @ (Z @ qp.grad_mu)
    d /= np.linalg.norm(d)
    moving = np.abs(d) > 1e-9
    ends = np.array([qp.lower - x, qp.upper - x])[:, moving] / d[moving]
    low, high = min(ends.min(axis=0).max(), 0.0), max(ends.max(axis=0).min(), 0.0)

    def distance(sign):
        def cost(t):
            return -sign * qp.c2 * (qp.grad_mu @ d) * t + 0.5 * qp.regularization * ((x + t * d) @ (x + t * d))

        edges = [t for t in (low, high) if np.isfinite(t)]
        ends = (max(low, -1e3), min(high, 1e3))
        inside = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 1e-12})
        return abs(min([*edges, inside.x], key=cost))

    scale = max(qp.c2 * np.abs(qp.grad_mu).max(), qp.regularization)
    slope = d @ (qp.regularization * x - qp.c2 * qp.grad_mu) / scale

    def reaches(t):  # is there a w with d . w = slope and |x - clip(x - w)| <= t?
        least = np.where(qp.upper - x <= t, -np.inf, -t)
        most = np.where(x - qp.lower <= t, np.inf, t)
        given = [d[j] * np.array([least[j], most[j]]) for j in np.flatnonzero(moving)]
        return sum(g.min() for g in given) <= slope <= sum(g.max() for g in given)

    short, long = 0.0, abs(slope) / np.abs(d).max() + 1.0
    for _ in range(60):
        middle = 0.5 * (short + long)
        short, long = (short, middle) if reaches(middle) else (middle, long)
    return long, distance(1.0), distance(-1.0)


@pytest.mark.parametrize("c2", [1e-3, 0.5])
def test_the_residuals_along_the_line_against_a_search(c2):
    """The elbow swivel alone, inside the box, at its sides and beyond: where rho decides, and where the box does.

    With several freedoms the way down is another one; see the wrong corners above.
    """
    rng = np.random.default_rng(12)
    seen = []
    for number in range(60):
        qp = random_problem(rng, c2=c2, regularization=c2 * 10.0 ** rng.uniform(-2.0, 1.0))
        Zs = null_space(qp.A)
        x = np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0] + rng.normal(size=len(Zs)) @ Zs
        if number % 3:
            x = np.clip(x, qp.lower, qp.upper)
        primal, outside, relative, off, opposite_off = answer_residuals(qp.row, 7, Zs, x)
        assert primal == pytest.approx(np.abs(qp.A @ x - qp.b).max(), abs=1e-12)
        assert outside == pytest.approx(max(0.0, (qp.lower - x).max(), (x - qp.upper).max()), abs=1e-12)
        wanted = along_the_line(qp, Zs, x)
        assert relative == pytest.approx(wanted[0], rel=1e-9, abs=1e-12)
        assert off == pytest.approx(wanted[1], rel=1e-5, abs=2e-6)
        assert opposite_off == pytest.approx(wanted[2], rel=1e-5, abs=2e-6)
        seen.append((outside, relative, off, opposite_off))
    assert (np.median(seen, axis=0)[1:] > 1e-3).all()  # not a test of zeros


def test_no_line_no_residual_along_it(qp, Z):
    """Without a pull along the self-motion, or without a kernel, every feasible answer is an optimum."""
    x = solved(qp).x
    for row, Zs in ((np.array(qp.row), np.zeros((0, 7))), (still(qp, "grad_mu"), Z), (still(qp, "c2"), Z)):
        assert answer_residuals(row, 7, Zs, x)[2:] == (0.0, 0.0, 0.0)
    faint = np.array(qp.row)
    fields(faint).grad_mu[:] *= 1e-9  # small is not none: what counts is its share along the self-motion
    assert answer_residuals(faint, 7, Z, x + 0.1 * Z[0] + 0.1 * Z[1])[2] > 0.0


def still(qp, name):
    row = np.array(qp.row)
    fields(row).grad_mu[:] *= name != "grad_mu"
    row[6 * 7 + 8 + 3 * 7] *= name != "c2"
    return row


def test_who_claims_nothing_is_only_held_to_the_box(qp, Z):
    x = opposite(qp).x
    mine = supervisor()
    assert np.array_equal(mine.solve(Scripted(Solution(x, None, Status.MAX_ITER)), qp, Z)[1], x)
    assert mine.fault is Fault.NONE
    mine.solve(Scripted(Solution(qp.upper + 1.0, None, Status.MAX_ITER)), qp, Z)
    assert mine.fault is Fault.OUTSIDE


@pytest.mark.parametrize("part", ["references", "box"])
def test_a_claim_must_meet_references_and_box(part, qp, Z):
    """Each on its own, just within its limit and just beyond; a claim is held to the same limit in both."""
    good, limit = solved(qp), SupervisorSettings().primal_limit
    for share, fault in ((0.9, Fault.NONE), (1.1, Fault.OUTSIDE)):
        row = np.array(qp.row)
        if part == "references":
            fields(row).b[0] += share * limit
        else:
            fields(row).upper[:] = np.maximum(fields(row).upper, good.x)
            fields(row).upper[6] = good.x[6] - share * limit
            fields(row).lower[6] = good.x[6] - 1.0
        moved = NullSpaceQP.from_row(row)
        mine = supervisor(relative_limit=1e9, opposite_limit=1e9)
        mine.solve(Scripted(good), moved, Z)
        assert mine.fault is fault, (part, share)


def test_the_clock_counts_the_solve_in_microseconds(qp, Z, monkeypatch):
    monkeypatch.setattr("moc_opt.control.supervisor.perf_counter_ns", iter([7_000_000, 7_250_500]).__next__)
    mine = supervisor(budget_us=250.4)
    mine.solve(Scripted(solved(qp)), qp, Z)
    assert mine.solve_us == pytest.approx(250.5)
    assert mine.fault is Fault.LATE


def test_settings_that_are_not_given_are_the_documented_ones():
    assert SupervisorSettings().model_dump() == {
        "check": True, "primal_limit": 1e-2, "box_limit": 0.1, "relative_limit": 0.05, "opposite_limit": 1e-3,
        "hold_ticks": 10, "keep_off_limits": True, "budget_us": None, "late": "hold",
    }  # fmt: skip
    assert SupervisorSettings(hold_ticks=0).hold_ticks == 0
    for field in ("primal_limit", "box_limit", "relative_limit", "opposite_limit", "budget_us"):
        assert getattr(SupervisorSettings(**{field: 0.5}), field) == 0.5
        with pytest.raises(ControlError, match=field):
            SupervisorSettings(**{field: 0.0})


@pytest.mark.parametrize("status", [Status.MAX_ITER, Status.TIME_LIMIT])
def test_who_claims_nothing_is_held_to_the_references_too(status, qp, Z):
    """Inside the box, and yet tip and wrist would go elsewhere."""
    best = solved(qp).x
    for gap, fault in ((0.05, Fault.NONE), (0.2, Fault.OUTSIDE)):
        way = np.linalg.svd(qp.A)[2][0]
        x = best + gap * way / np.abs(qp.A @ way).max()
        row = np.array(qp.row)
        part = fields(row)
        part.lower[:], part.upper[:] = np.minimum(part.lower, x), np.maximum(part.upper, x)
        wide = NullSpaceQP.from_row(row)
        mine = supervisor()
        mine.solve(Scripted(Solution(x, None, status)), wide, Z)
        assert mine.fault is fault


@pytest.mark.parametrize("rho", [0.0, 0.3])
@pytest.mark.parametrize("tilt", [1.0, 1e-3])
@pytest.mark.parametrize("n", [7, 8, 9])
def test_wrong_corners_of_several_freedoms_are_lies(n, tilt, rho):
    """Two to four freedoms, and as much gradient along them as across, or a thousandth: claimed, and refused."""
    wrong = wrong_corners(n, n, 10, tilt=tilt, regularization=rho)
    faults = []
    for w in wrong:
        mine = Supervisor(SupervisorSettings(), "damping", n)
        mine.solve(Scripted(Solution(w.x, None, Status.SOLVED)), w.qp, null_space(w.qp.A))
        faults.append(mine.fault)
    assert np.mean([fault is Fault.FALSE_OPTIMUM for fault in faults]) >= (1.0 if rho == 0.0 else 0.9)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10**6), n=st.sampled_from([7, 8, 9, 10]), rho=st.sampled_from([0.0, 1e-5, 1e-3]),
    off=st.sampled_from([0.0, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2]),
)  # fmt: skip
def test_with_several_freedoms_too_what_is_verified_is_taken(seed, n, rho, off):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, n, structured=False, regularization=rho)
    Z = null_space(problem.A)
    x = solved(problem).x + off * Z.T @ rng.normal(size=len(Z))
    found = problem.residuals(x)
    mine = Supervisor(SupervisorSettings(), "damping", n)
    mine.solve(Scripted(Solution(x, None, Status.SOLVED)), problem, Z)
    if found.verified():
        assert mine.fault is Fault.NONE
    assert off > 0.0 or found.verified()
    relative = answer_residuals(problem.row, n, Z, x)[2]
    assert relative <= found.relative * (1.0 + 1e-6) + 1e-6  # joints that hardly move do not end the line


def test_the_check_can_be_switched_off(qp, Z):
    mine = supervisor(check=False)
    mine.solve(Scripted(opposite(qp)), qp, Z)
    assert mine.fault is Fault.NONE


@pytest.mark.parametrize("n", [8, 9])
def test_an_optimum_of_several_freedoms_is_nowhere_off(n):
    qp = random_problem(np.random.default_rng(n), n, structured=False)
    found = answer_residuals(qp.row, n, np.ascontiguousarray(np.linalg.svd(qp.A)[2][5:]), Exact().start(qp).solve(qp).x)
    np.testing.assert_allclose(found, 0.0, atol=1e-6)
    assert found[3:] == (0.0, 0.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("idle_speed", [0.0, 0.5])
def test_an_idle_joint_says_nothing_about_the_freedoms_that_count(seed, idle_speed):
    """Of nine joints the last moves neither tip nor wrist: at the optimum of the others nothing is left to gain."""
    eight = random_problem(np.random.default_rng(seed), 8, structured=False, regularization=1e-3)
    still = np.zeros((3, 1))
    nine = NullSpaceQP(
        np.hstack([eight.J_tip, still]), np.hstack([eight.J_wrist, still]), eight.v_tip, eight.v_wrist,
        np.r_[eight.grad_mu, 0.0], np.r_[eight.lower, -1.0], np.r_[eight.upper, 1.0], regularization=1e-3,
    )  # fmt: skip
    x = np.r_[solved(eight).x, idle_speed]
    *_, natural, off, _ = answer_residuals(nine.row, 9, null_space(nine.A), x)
    assert natural < 1e-6
    assert off == 0.0
    mine = Supervisor(SupervisorSettings(), "damping", 9)
    mine.solve(Scripted(Solution(x, None, Status.SOLVED)), nine, null_space(nine.A))
    assert mine.fault is Fault.NONE


def test_both_ends_of_a_box_that_leaves_no_room_are_right(qp, Z):
    """The ends of the line lie nearer to each other than ``opposite_limit``: none of them is false."""
    x, along = solved(qp).x, 1e-4 * Z[0]
    low, high = np.minimum(x - along, x + along), np.maximum(x - along, x + along)
    narrow = NullSpaceQP(
        qp.J_tip, qp.J_wrist, *np.split(qp.A @ x, 2), qp.grad_mu, low, high, regularization=qp.regularization
    )
    for end in (x - along, x + along):
        mine = supervisor()
        mine.solve(Scripted(Solution(end, None, Status.SOLVED)), narrow, Z)
        assert mine.fault is Fault.NONE


@pytest.mark.parametrize("seed", range(5))
def test_an_idle_joint_that_is_the_only_freedom_is_judged_as_one(seed):
    """Five joints for five independent rows, and one that moves neither tip nor wrist."""
    qp, joints = random_problem(np.random.default_rng(seed)), [0, 1, 2, 3, 4, 6]
    A, x = qp.A[:, joints], 0.5 * (qp.lower + qp.upper)[joints]
    one = NullSpaceQP(*np.split(A, 2), *np.split(A @ x, 2), np.r_[qp.grad_mu[:5], 0.2],
                      qp.lower[joints], qp.upper[joints])  # fmt: skip
    for end, wrong in ((one.lower[5], True), (one.upper[5], False)):
        x[5] = end
        *_, natural, off, opposite = answer_residuals(one.row, 6, np.eye(6)[5:], x)
        assert (natural > 0.1) == (off > opposite) == wrong
        assert one.residuals(x).verified() != wrong


@pytest.mark.parametrize("late", ["hold", "zero", "iterate"])
def test_late_answers(late, qp, Z):
    good = solved(qp)
    other = Solution(good.x + 1e-6, None, Status.SOLVED)
    mine = supervisor(times=[10.0, 3000.0, 2000.0], budget_us=2000.0, late=late)
    mine.solve(Scripted(good), qp, Z)
    assert mine.fault is Fault.NONE
    assert mine.solve_us == 10.0
    _, x = mine.solve(Scripted(other), qp, Z)
    assert mine.fault is Fault.LATE
    np.testing.assert_array_equal(x, {"hold": good.x, "zero": np.zeros(7), "iterate": other.x}[late])
    mine.solve(Scripted(other), qp, Z)
    assert mine.fault is Fault.NONE


def test_a_late_lie_is_not_followed_as_an_iterate(qp, Z):
    mine = supervisor(times=[1e6], budget_us=1.0, late="iterate")
    _, x = mine.solve(Scripted(opposite(qp)), qp, Z)
    assert mine.fault is Fault.FALSE_OPTIMUM
    assert not x.any()


class Stoppable(Scripted):
    """A session whose truncated answer is known, and who is asked for it."""

    def __init__(self, whole, truncated):
        super().__init__(whole)
        self.cut, self.asked = truncated, []

    def truncated(self, qp, iterations):
        self.asked.append(iterations)
        if isinstance(self.cut, Exception):
            raise self.cut
        return self.cut


@pytest.mark.parametrize(
    ("us", "iterations", "allowed"),
    [(400.0, 40, 10), (1e6, 40, 1), (99.0, 40, None), (400.0, 1, 1), (400.0, 0, None)],
)
def test_a_late_solver_is_stopped_where_it_can_be(us, iterations, allowed, qp, Z):
    whole = solved(qp)._replace(iterations=iterations)
    session = Stoppable(whole, whole._replace(x=0.5 * whole.x, status=Status.MAX_ITER))
    mine = supervisor(times=[us], budget_us=100.0, late="iterate")
    solution, x = mine.solve(session, qp, Z)
    assert session.asked == ([] if allowed is None else [allowed])
    assert mine.fault is (Fault.NONE if us < 100.0 else Fault.LATE)
    np.testing.assert_array_equal(x, whole.x if allowed is None else 0.5 * whole.x)
    assert solution.status is (Status.SOLVED if allowed is None else Status.MAX_ITER)


@pytest.mark.parametrize(
    ("cut", "fault"),
    [(ValueError("no"), Fault.RAISED), (Solution(np.full(7, 9e3), None, Status.MAX_ITER), Fault.OUTSIDE),
     (Solution(np.full(7, np.nan), None, Status.MAX_ITER), Fault.NOT_FINITE)],
)  # fmt: skip
def test_a_truncated_answer_is_checked_like_any_other(cut, fault, qp, Z):
    mine = supervisor(times=[10.0, 400.0], budget_us=100.0, late="iterate")
    good = solved(qp)
    mine.solve(Scripted(good), qp, Z)
    _, x = mine.solve(Stoppable(good._replace(iterations=4), cut), qp, Z)
    assert mine.fault is fault
    np.testing.assert_array_equal(x, good.x)


@pytest.mark.parametrize("late", ["hold", "zero"])
def test_no_one_is_stopped_whose_answer_is_not_wanted(late, qp, Z):
    session = Stoppable(solved(qp)._replace(iterations=4), solved(qp))
    supervisor(times=[400.0], budget_us=100.0, late=late).solve(session, qp, Z)
    assert session.asked == []


def test_recorded_times_that_end_leave_the_rest_to_the_clock(qp, Z):
    mine = supervisor(times=[5.0])
    good = solved(qp)
    times = []
    for _ in range(2):
        mine.solve(Scripted(good), qp, Z)
        times.append(mine.solve_us)
    assert times[0] == 5.0
    assert times[1] > 0.0
    assert times[1] != 5.0


@pytest.mark.parametrize("fallback", ["damping", "hold", "least-violation"])
def test_an_infeasible_subproblem_is_answered_by_the_fallback(fallback, qp, Z):
    mine = supervisor(fallback)
    good = solved(qp)
    mine.solve(Scripted(good), qp, Z)
    _, x = mine.solve(Scripted(no_answer(7, Status.INFEASIBLE)), qp, Z)
    if fallback == "least-violation":
        assert np.abs(qp.A @ x - qp.b).max() < 1e-3
        assert (x <= qp.upper + 1e-12).all()
    else:
        np.testing.assert_array_equal(x, np.zeros(7) if fallback == "damping" else good.x)


@pytest.mark.parametrize(
    "field", [{"hold_ticks": -1}, {"budget_us": 0.0}, {"late": "never"}, {"relative_limit": -1.0}]
)
def test_wrong_settings_name_the_field(field):
    with pytest.raises(ControlError, match=next(iter(field))):
        SupervisorSettings(**field)


@pytest.mark.parametrize("kind", KINDS)
def test_tip_and_rcm_do_not_depend_on_the_third_level(kind, robot):
    """One state, two controllers: one is told the truth, one is not. Tip and wrist accelerate alike."""
    setup = Setup(Scenario(control={"preset": "tuned"}, **QUICK))
    control = setup.scenario.control
    good = Controller(robot, control, Exact())
    bad = Controller(robot, control, Faulty(Exact(), kind, rate=1.0))
    rng = np.random.default_rng(5)
    q = setup.q_start
    for mine in (good, bad):
        mine.start(robot.state(q), reference(setup, 0.0), trocar(setup, 0.0))
    for k in range(30):
        state = robot.state(q + 1e-4 * rng.normal(size=7), 1e-2 * rng.normal(size=7))
        t = 0.6 + 0.002 * k
        torques = [mine.tick(state, reference(setup, t), trocar(setup, t)) for mine in (good, bad)]
        assert good.fault is Fault.NONE
        assert bad.fault is not Fault.NONE
        change = state.A @ np.linalg.solve(state.M, torques[1] - torques[0])
        assert np.abs(change).max() < 1e-8
        # both observers are shown the same past, so that they say the same
        for mine in (good, bad):
            mine.set_applied_torque(torques[0])
    assert np.abs(torques[1] - torques[0]).max() > 1e-3  # or the test would compare a thing with itself


def reference(setup, t):
    return np.stack(setup.reference.at(t))


def trocar(setup, t):
    return np.stack(setup.registered.at(t))


@pytest.mark.parametrize("name", [name for name, reason in available().items() if reason is None])
def test_honest_solvers_are_not_refused(name):
    """No registered solver, as it comes, loses more than one percent of its ticks to the check."""
    trace = run(Scenario(solver={"name": name}, judge=False, **QUICK))
    refused = np.isin(trace.fault, ("lied", "outside", "late", "not_finite", "malformed", "raised"))
    assert refused.mean() <= 0.01, dict(zip(*np.unique(trace.fault, return_counts=True), strict=True))


def test_a_run_with_replayed_times_repeats_itself_to_the_bit(robot):
    setup = Setup(Scenario(control={"preset": "tuned"}, **QUICK))
    control = ControlSettings.tuned(supervisor=SupervisorSettings(budget_us=100.0))

    def torques():
        times = itertools.cycle([10.0, 10.0, 500.0])
        mine = Controller(robot, control, Exact(), times_us=times)
        mine.start(robot.state(setup.q_start), reference(setup, 0.0), trocar(setup, 0.0))
        found, faults = [], []
        for k in range(30):
            t = 0.6 + 0.002 * k
            found.append(mine.tick(robot.state(setup.q_start), reference(setup, t), trocar(setup, t)))
            faults.append(mine.fault)
        assert faults == [Fault.NONE, Fault.NONE, Fault.LATE] * 10
        return np.array(found)

    np.testing.assert_array_equal(torques(), torques())


class Booms:
    """Raises at every tick, each time in other words; or when it is stopped."""

    def __init__(self, qp, error=RuntimeError):
        self.count, self.qp, self.error = 0, qp, error

    def solve(self, qp):
        self.count += 1
        raise self.error(f"boom\n{self.count}")


class Mute(Exception):
    def __str__(self):
        raise ValueError("no text")


class Leaving(BaseException):
    def __str__(self):
        raise GeneratorExit


def nameless(text):
    """An exception whose class raises where it is asked for its name."""

    class Unnamed(type):
        @property
        def __name__(cls):
            raise ValueError("no name")

    return Unnamed("Nameless", (Exception,), {})(text)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (Leaving, "Leaving: (its text raised GeneratorExit)"),
        (nameless, "Nameless: boom 1"),
        (lambda text: ValueError(f"\x1b]0;{text}\x07\u202e"), "ValueError: \ufffd]0;boom 1\ufffd\ufffd"),
    ],
    ids=["leaving", "nameless", "control"],
)
def test_what_an_exception_says_of_itself_ends_no_run_and_steers_no_terminal(error, said, qp, Z):
    mine = supervisor()
    mine.solve(Booms(qp, error), qp, Z)
    assert mine.firsts["raised"] == (0, said)


def test_what_a_solver_raised_first_is_kept_in_its_own_words(qp, Z):
    mine = supervisor()
    mine.solve(Scripted(solved(qp)), qp, Z)
    assert mine.firsts == {}
    session = Booms(qp)
    for _ in range(3):
        mine.solve(session, qp, Z)
    assert mine.firsts == {"raised": (1, "RuntimeError: boom 1")}
    assert mine.counts["raised"] == 3
    mine.solve(Scripted(no_answer(7, Status.NUMERICAL)), qp, Z)
    assert mine.firsts["failed"] == (4, f"{Fault.FAILED.value} ({Status.NUMERICAL.value})")
    mine.forget()
    assert mine.firsts == {}
    mine.solve(Booms(qp, Mute), qp, Z)
    assert mine.firsts["raised"] == (0, "Mute: (its text raised ValueError)")


def test_an_exception_when_stopped_late_is_kept_too(qp, Z):
    mine = supervisor(times=[400.0], budget_us=100.0, late="iterate")
    mine.solve(Stoppable(solved(qp)._replace(iterations=4), ValueError("cannot stop")), qp, Z)
    assert mine.firsts == {"raised": (0, "ValueError: cannot stop")}


def test_a_trace_says_which_answers_were_refused_and_why():
    scenario = Scenario(duration_s=0.2, bound_samples=0, faults={"solver": "raise", "solver_share": 0.1})
    trace = run(scenario)
    first = int(np.flatnonzero(trace.fault == "raised")[0])
    assert trace.meta["faults"] == {
        "raised": {
            "count": int((trace.fault == "raised").sum()), "first_at_s": pytest.approx(0.002 * first),
            "first": "InjectedFault: faulty: raised on purpose",
        }
    }  # fmt: skip
    assert run(Scenario(duration_s=0.02, bound_samples=0)).meta["faults"] == {}


@pytest.mark.parametrize("fallback", ["damping", "hold", "least-violation"])
def test_what_stands_in_is_compiled_before_the_loop(fallback, qp, Z, monkeypatch):
    ran = []
    monkeypatch.setattr("moc_opt.control.supervisor.least_violation", lambda *given: ran.append("least-violation"))
    monkeypatch.setattr("moc_opt.control.supervisor.into_the_box", lambda *given: ran.append("retreat"))
    supervisor(fallback).warm_up(qp, Z)
    assert sorted(ran) == (["least-violation"] if fallback == "least-violation" else []) + ["retreat"]
