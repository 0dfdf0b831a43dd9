"""Nobody trusts the third level: what is refused, what stands in, and what never changes because of it."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.answers import answer_residuals, well_formed
from moc_opt.control.manipulability import null_space
from moc_opt.control.supervisor import Fault, Supervisor, SupervisorSettings
from moc_opt.errors import ControlError
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.solvers import available
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.exact import Exact
from moc_opt.solvers.faulty import KINDS, Faulty
from moc_opt.subproblem import NullSpaceQP, fields, judge
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
    """Subproblems of closed-loop runs, with and without damping of the cost, far from and near the optimum."""
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
    assert solution is good
    np.testing.assert_array_equal(x, good.x)
    assert not np.shares_memory(x, good.x)
    assert mine.counts == {}


def wrong_answers(qp):
    x = solved(qp).x
    return {
        Fault.FAILED: no_answer(7, Status.NUMERICAL),
        Fault.RAISED: RuntimeError("from inside a solver"),
        Fault.NOT_FINITE: Solution(np.where(np.arange(7) == 3, np.nan, x), None, Status.SOLVED),
        Fault.OUTSIDE: Solution(x + 0.5, None, Status.SOLVED),
        Fault.LIED: opposite(qp),
        Fault.INFEASIBLE: no_answer(7, Status.INFEASIBLE),
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


def test_damping_keeps_off_the_limits(qp, Z):
    """Once holding is over the elbow moves as far as the box asks for, and no further; or not at all, if told so."""
    tight, shortest = near_a_limit(qp, Z)
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
    assert 0.045 < room < 0.1
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
    assert mine.fault in (Fault.FAILED, Fault.NOT_FINITE)
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


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(7))
def test_what_is_not_finite_is_told_by_nan(bad, place, qp, Z):
    x = np.zeros(7)
    x[place] = bad
    assert np.isnan(answer_residuals(qp.row, 7, Z, x)).all()


def test_wrong_duals_do_not_cost_the_answer(qp, Z):
    good = solved(qp)
    mine = supervisor()
    solution, x = mine.solve(Scripted(Solution(good.x, np.zeros(5), Status.SOLVED)), qp, Z)
    assert mine.fault is Fault.NONE
    assert solution.y is None
    np.testing.assert_array_equal(x, good.x)
    assert well_formed(good, 7) is good


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
        seen = mine.fault is Fault.LIED
        right = bool(judge(row[None], lie.x[None]).verified()[0])
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
    if judge(row[None], x[None]).verified()[0]:
        assert mine.fault is Fault.NONE
    if place == 0.0:
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
        found = judge(row[None], x[None])
        assert max(primal, outside) == pytest.approx(found.primal[0], abs=1e-12)
        assert relative <= found.relative[0] * (1 + 1e-6) + 1e-9  # one of the directions the judge tries
        assert off <= np.linalg.norm(x - exact.x) + 1e-6
        assert answer_residuals(qp.row, 7, Zs, exact.x)[2:4] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_who_claims_nothing_is_only_held_to_the_box(qp, Z):
    x = opposite(qp).x
    mine = supervisor()
    assert np.array_equal(mine.solve(Scripted(Solution(x, None, Status.MAX_ITER)), qp, Z)[1], x)
    assert mine.fault is Fault.NONE
    mine.solve(Scripted(Solution(qp.upper + 1.0, None, Status.MAX_ITER)), qp, Z)
    assert mine.fault is Fault.OUTSIDE


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


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("tilt", [1.0, 1e-3])
@pytest.mark.parametrize("n", [7, 8, 9])
def test_wrong_corners_of_several_freedoms_are_lies(n, tilt, damping):
    """Two to four freedoms, and as much gradient along them as across, or a thousandth: claimed, and refused."""
    wrong = wrong_corners(n, n, 10, tilt=tilt, damping=damping)
    faults = []
    for w in wrong:
        mine = Supervisor(SupervisorSettings(), "damping", n)
        mine.solve(Scripted(Solution(w.x, None, Status.SOLVED)), w.qp, null_space(w.qp.A))
        faults.append(mine.fault)
    assert np.mean([fault is Fault.LIED for fault in faults]) >= (1.0 if damping == 0.0 else 0.9)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10**6), n=st.sampled_from([7, 8, 9, 10]), damping=st.sampled_from([0.0, 1e-5, 1e-3]),
    off=st.sampled_from([0.0, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2]),
)  # fmt: skip
def test_with_several_freedoms_too_what_is_verified_is_taken(seed, n, damping, off):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, n, structured=False, damping=damping)
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


@pytest.mark.parametrize("late", ["hold", "zero", "iterate"])
def test_late_answers(late, qp, Z):
    good = solved(qp)
    other = Solution(good.x + 1e-6, None, Status.SOLVED)
    mine = supervisor(times=[10.0, 3000.0, 10.0], budget_us=2000.0, late=late)
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
    assert mine.fault is Fault.LIED
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


@pytest.mark.parametrize(("us", "iterations", "allowed"), [(400.0, 40, 10), (1e6, 40, 1), (99.0, 40, None)])
def test_a_late_solver_is_stopped_where_it_can_be(us, iterations, allowed, qp, Z):
    whole = solved(qp)._replace(iterations=iterations)
    session = Stoppable(whole, whole._replace(x=0.5 * whole.x, status=Status.MAX_ITER))
    mine = supervisor(times=[us], budget_us=100.0, late="iterate")
    solution, x = mine.solve(session, qp, Z)
    assert session.asked == ([] if allowed is None else [allowed])
    assert mine.fault is (Fault.NONE if allowed is None else Fault.LATE)
    np.testing.assert_array_equal(x, whole.x if allowed is None else 0.5 * whole.x)
    assert solution.status is (Status.SOLVED if allowed is None else Status.MAX_ITER)


@pytest.mark.parametrize(
    ("cut", "fault"),
    [(ValueError("no"), Fault.FAILED), (Solution(np.full(7, 9e3), None, Status.MAX_ITER), Fault.OUTSIDE),
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
            mine.sent(torques[0])
    assert np.abs(torques[1] - torques[0]).max() > 1e-3  # or the test would compare a thing with itself


def reference(setup, t):
    return np.stack(setup.reference.at(t))


def trocar(setup, t):
    return np.stack(setup.registered.at(t))


@pytest.mark.parametrize("name", [name for name, reason in available().items() if reason is None])
def test_honest_solvers_are_not_refused(name):
    """No registered solver, as it comes, loses more than one percent of its ticks to the check."""
    trace = run(Scenario(solver={"name": name}, judge=False, **QUICK))
    refused = np.isin(trace.fault, ("lied", "outside", "late", "not_finite", "raised"))
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
