"""The supervisor of the third level refuses wrong answers."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.supervisor import Fault, SupervisorSettings
from moc_opt.qp.problem import NullSpaceQP, fields
from moc_opt.scenario import Scenario, run
from moc_opt.solvers import available
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.exact import Exact
from moc_opt.solvers.faulty import KINDS, Faulty
from moc_opt.solvers.isolated import Unanswered
from tests.control.torques import Supervisor, in_place, law
from tests.problems import changed, random_problem
from tests.reference.law import null_space
from tests.wrong_answers import wrong_corners

QUICK = {"bound_samples": 0, "judge": False, "duration_s": 0.4}
ZERO, OK, LATE = np.zeros(7), Status.SOLVED, ["hold", "zero", "iterate"]


def scripted(*answers):
    """A session that returns or raises these answers in turn."""
    return Mock(spec=["solve"], **{"solve.side_effect": list(answers)})


@pytest.fixture(scope="module")
def recorded():
    traces = (run(Scenario(control=control, **{**QUICK, "duration_s": 1.5}))
              for control in ({"preset": "tuned"}, {}, {"preset": "paper"}))  # fmt: skip
    return np.concatenate([trace.subproblem[::12] for trace in traces])


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
    fields(row).pull[:] *= -1.0
    return solved(NullSpaceQP.from_row(row))


def supervisor(fallback="damping", times=None, **changes):
    return Supervisor(SupervisorSettings(**changes), fallback, 7, None if times is None else iter(times))


def asked(qp, Z, answer, n=7, v=None, **changes):
    """Return the supervisor, the solution and the x that the arm follows."""
    mine = Supervisor(SupervisorSettings(**changes), "damping", n)
    session = answer if hasattr(answer, "solve") else scripted(answer)
    return mine, *mine.solve(session, qp, Z, v)


def judged(row, Z, x):
    """Return moc_residuals (shared.h): primal, outside, natural, off (from optimum), opposite (from that of -pull)."""
    made = law(len(x))
    made.load(row, np.ascontiguousarray(Z))
    return made.judge(np.ascontiguousarray(x))


def test_good_answer_is_copied_and_followed(qp, Z):
    good = solved(qp)
    for x in (good.x, np.repeat(good.x, 3)[1::3], good.x[::-1].copy()[::-1]):
        mine, solution, followed = asked(qp, Z, Solution(x, good.y, Status.SOLVED, np.int64(2**31 - 1)))
        assert (mine.fault, mine.faults, solution.x.strides) == (Fault.NONE, {}, (8,))
        for copied, of in ((solution.x, x), (solution.y, good.y), (followed, x)):
            np.testing.assert_array_equal(copied, of)
            assert not np.shares_memory(copied, of)


@pytest.mark.parametrize("fault", [f for f in Fault if f not in (Fault.NONE, Fault.LATE)])
def test_each_fault_is_named_and_counted(fault, qp, Z):
    good = solved(qp)
    wrong = {
        Fault.FAILED: no_answer(7, Status.NUMERICAL), Fault.RAISED: RuntimeError("from inside\na solver"),
        Fault.NOT_FINITE: Solution(np.where(np.arange(7) == 3, np.nan, good.x), None, Status.SOLVED),
        Fault.MALFORMED: Solution(good.x, np.zeros(6, complex), Status.SOLVED),
        Fault.OUTSIDE: Solution(good.x + 0.5, None, Status.SOLVED), Fault.FALSE_OPTIMUM: opposite(qp),
        Fault.INFEASIBLE: no_answer(7, Status.INFEASIBLE), Fault.LOST: Unanswered("lost", "its process ended"),
    }
    mine = supervisor()
    mine.solve(scripted(good), qp, Z)
    _, x = mine.solve(scripted(wrong[fault]), qp, Z)
    assert mine.fault is fault
    ((label, found),) = mine.faults.items()
    assert (label, found["count"], found["first_at_s"]) == (fault.label, 1, 0.002)
    assert fault is not Fault.RAISED or "RuntimeError: from inside a solver (mock.py, line " in found["first"]
    # after any fault except INFEASIBLE, the last good answer is held
    np.testing.assert_array_equal(x, np.zeros(7) if fault is Fault.INFEASIBLE else good.x)
    mine.forget()
    assert mine.faults == {}


@pytest.mark.parametrize("hold", [0, 1, 4])
def test_last_good_answer_is_held_for_hold_ticks(hold, qp, Z):
    mine = supervisor(hold_ticks=hold)
    wrong = no_answer(7, Status.NUMERICAL)
    mine.solve(scripted(solved(qp)), qp, Z)
    held = [bool(mine.solve(scripted(wrong), qp, Z)[1].any()) for _ in range(hold + 3)]
    assert held == [True] * hold + [False] * 3
    mine.solve(scripted(solved(qp)), qp, Z)
    assert mine.solve(scripted(wrong), qp, Z)[1].any() == (hold > 0)  # a good answer restarts the count


def test_without_solver_answers_the_arm_stays_off_its_joint_limits(robot):
    """If the third level only damped, joint 6 would reach its limit."""
    base = Scenario(control={"preset": "tuned"}, start={"swivel": "random"}, judge=False, bound_samples=0,
                    faults={"solver": "nan", "solver_share": 1.0})  # fmt: skip
    kept = run(base)
    assert not kept.limited.any()
    room = np.minimum(robot.q_max - kept.q_rad, kept.q_rad - robot.q_min).min()
    assert 0.15 < room < 0.2
    bare = run(base.change(control={"supervisor": {"keep_off_limits": False}}))
    assert bare.limited.any()
    assert kept.rcm_error_m.mean() < 0.9 * bare.rcm_error_m.mean()
    assert kept.tip_error_m.max() < 0.2 * bare.tip_error_m.max()


@pytest.mark.parametrize(("answer", "told"), [
    (None, "solve returned a NoneType"), ((ZERO, None, OK, 0), "solve returned a tuple"),
    (Solution(ZERO, None, "great"), "the status is a str"), (Solution([0.0] * 7, None, OK), "x is a list"),
    (Solution(ZERO.astype(np.float32), None, OK), "x is an array of float32"),
    (Solution(ZERO[:, None], None, OK), "x has shape (7, 1)"), (Solution(ZERO, [0.0] * 6, OK), "y is a list"),
    (Solution(ZERO, np.zeros(6, complex), OK), "y is an array of complex128"),
    (Solution(ZERO, ZERO[:5], OK), "y has shape (5,)"),
    *((Solution(ZERO, None, OK, n), "iterations ") for n in ("many", None, -1, 2**31, True)),
])  # fmt: skip
def test_message_says_what_is_malformed(answer, told, qp, Z):
    mine, solution, x = asked(qp, Z, answer)
    assert mine.fault is Fault.MALFORMED
    assert mine.faults["malformed"]["first"].startswith(told)
    assert solution.x.shape == (7,)
    assert not x.any()


def test_solver_that_writes_into_its_arguments_changes_nothing(qp, Z):
    def solve(shown):
        for array in (shown.row, shown.row if shown.row.base is None else shown.row.base):
            array.setflags(write=True)
            part = fields(array)
            part.A[:], part.b[:], part.lower[:], part.upper[:] = 0.0, 0.0, -1e3, 1e3
        return Solution(np.full(7, 50.0), None, Status.SOLVED)

    before, v, session = np.array(qp.row), np.zeros(7), Mock(spec=["solve", "observe"])
    session.solve, session.observe.side_effect = solve, lambda v: v.fill(1e3)
    mine, _, x = asked(qp, Z, session, v=v)
    assert mine.fault is Fault.OUTSIDE
    assert not x.any()
    np.testing.assert_array_equal(qp.row, before)
    np.testing.assert_array_equal(v, 0.0)


@pytest.mark.parametrize("error", [SystemExit("enough"), RuntimeError("no"), MemoryError(), KeyboardInterrupt()])
@pytest.mark.parametrize("where", ["observe", "solve", "under another error"])
def test_exceptions_of_a_session_except_keyboard_interrupt_are_counted(error, where, qp, Z):
    raised, session = error, Mock(spec=["solve", "observe"])
    if where == "under another error":  # as CasADi wraps exceptions
        raised = SystemError("returned a result with an exception set")
        raised.__cause__ = error
    getattr(session, "observe" if where == "observe" else "solve").side_effect = raised
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            asked(qp, Z, session, v=np.zeros(7))
        return
    mine, _, x = asked(qp, Z, session, v=np.zeros(7))
    assert mine.fault is Fault.RAISED
    assert mine.faults["raised"]["first"].startswith("SystemError" if "under" in where else type(error).__name__)
    assert np.isfinite(x).all()


def test_optimum_for_negated_gradient_is_refused(recorded):
    """Only an answer that is also optimal for the true gradient, within the tolerances, is accepted."""
    lies = 0
    for qp in map(NullSpaceQP.from_row, recorded):
        lie = opposite(qp)
        if lie.status is Status.SOLVED:
            seen = asked(qp, null_space(qp.A), lie)[0].fault is Fault.FALSE_OPTIMUM
            assert asked(qp, null_space(qp.A), lie, check=False)[0].fault is Fault.NONE
            assert seen or qp.residuals(lie.x).verified(), judged(qp.row, null_space(qp.A), lie.x)
            lies += seen
    assert lies > 100


def along_the_line(qp, Z, x):
    """Compute the residuals `natural`, `off` and `opposite` of x by numerical search."""
    d = Z.T @ (Z @ qp.pull)
    d /= np.linalg.norm(d)
    moving = np.abs(d) > 1e-9
    ends = np.array([qp.lower - x, qp.upper - x])[:, moving] / d[moving]
    low, high = min(ends.min(axis=0).max(), 0.0), max(ends.max(axis=0).min(), 0.0)

    def distance(sign):
        def cost(t):
            return -sign * qp.c2 * (qp.pull @ d) * t + 0.5 * qp.regularization * ((x + t * d) @ (x + t * d))

        edges = [t for t in (low, high) if np.isfinite(t)]
        ends = (max(low, -1e3), min(high, 1e3))
        inside = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 1e-12})
        return abs(min([*edges, inside.x], key=cost))

    scale = max(qp.c2 * np.abs(qp.pull).max(), qp.regularization)
    slope = d @ (qp.regularization * x - qp.c2 * qp.pull) / scale

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
def test_residuals_along_self_motion_agree_with_numerical_search(c2):
    rng, seen = np.random.default_rng(12), []
    for number in range(60):
        qp = random_problem(rng, c2=c2, regularization=c2 * 10.0 ** rng.uniform(-2.0, 1.0))
        Zs = null_space(qp.A)
        x = np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0] + rng.normal(size=len(Zs)) @ Zs
        if number % 3:
            x = np.clip(x, qp.lower, qp.upper)
        primal, outside, natural, off, opposite_off = judged(qp.row, Zs, x)
        assert primal == pytest.approx(np.abs(qp.A @ x - qp.b).max(), abs=1e-12)
        assert outside == pytest.approx(max(0.0, (qp.lower - x).max(), (x - qp.upper).max()), abs=1e-12)
        wanted = along_the_line(qp, Zs, x)
        assert natural == pytest.approx(wanted[0], rel=1e-9, abs=1e-12)
        assert off == pytest.approx(wanted[1], rel=1e-5, abs=2e-6)
        assert opposite_off == pytest.approx(wanted[2], rel=1e-5, abs=2e-6)
        seen.append((outside, natural, off, opposite_off))
    assert (np.median(seen, axis=0)[1:] > 1e-3).all()


def test_without_gradient_along_self_motion_the_residuals_are_zero(qp, Z):
    x = solved(qp).x
    for pull, c2, Zs in ((1.0, 1.0, np.zeros((0, 7))), (0.0, 1.0, Z), (1.0, 0.0, Z), (1e-9, 1.0, Z)):
        row = np.array(qp.row)
        fields(row).pull[:] *= pull
        fields(row).weights[2] *= c2
        if pull == 1e-9:  # a small gradient does not count as zero
            assert judged(row, Zs, x + 0.1 * Z[0] + 0.1 * Z[1])[2] > 0.0
        else:
            assert judged(row, Zs, x)[2:] == (0.0, 0.0, 0.0)


def test_solve_time_in_microseconds_is_compared_with_budget(qp, Z, monkeypatch):
    monkeypatch.setattr("moc_opt.control.supervisor.perf_counter_ns", iter([7_000_000, 7_250_500]).__next__)
    mine = supervisor(budget_us=250.4)
    mine.solve(scripted(solved(qp)), qp, Z)
    assert mine.solve_us == pytest.approx(250.5)
    assert mine.fault is Fault.LATE


@pytest.mark.parametrize("rho", [0.0, 0.3])
@pytest.mark.parametrize("tilt", [1.0, 1e-3])
@pytest.mark.parametrize("n", [7, 8, 9])
def test_wrong_vertices_of_the_feasible_set_are_refused(n, tilt, rho):
    """With a small `tilt`, most of the gradient is perpendicular to the null space."""
    wrong = wrong_corners(n, n, 10, tilt=tilt, regularization=rho)
    faults = [asked(w.qp, null_space(w.qp.A), Solution(w.x, None, Status.SOLVED), n)[0].fault for w in wrong]
    assert np.mean([fault is Fault.FALSE_OPTIMUM for fault in faults]) >= (1.0 if rho == 0.0 else 0.9)


@settings(max_examples=300)
@given(
    seed=st.integers(0, 10**6), n=st.sampled_from([7, 8, 9, 10]), rho=st.sampled_from([0.0, 1e-5, 1e-3]),
    off=st.just(0.0) | st.floats(-9.0, -1.0).map(lambda k: 10.0**k), rest=st.none() | st.floats(-12.0, 0.0),
)  # fmt: skip
def test_every_verified_answer_is_accepted(seed, n, rho, off, rest):
    """With `rest`, (rho / c2) x_d replaces the gradient."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, n, structured=n == 7, regularization=rho)
    if rest is not None and rho > 0.0:
        row = np.array(problem.row)
        fields(row).pull[:] = rho / problem.c2 * 10.0 ** (rest + 1.0) * rng.normal(size=n)
        problem = NullSpaceQP.from_row(row)
    Z = null_space(problem.A)
    x = solved(problem).x + off * Z.T @ rng.normal(size=len(Z))
    found = problem.residuals(x)
    mine, *_ = asked(problem, Z, Solution(x, None, Status.SOLVED), n)
    if found.verified():
        assert mine.fault is Fault.NONE
    assert off > 0.0 or found.verified()
    natural = judged(problem.row, Z, x)[2]
    assert natural <= found.relative * (1.0 + 1e-6) + 1e-6  # `judged` ignores joints that hardly move


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("idle_speed", [0.0, 0.5])
def test_optimum_is_accepted_at_any_speed_of_an_idle_joint(seed, idle_speed):
    eight = random_problem(np.random.default_rng(seed), 8, structured=False, regularization=1e-3)
    still = np.zeros((3, 1))
    nine = NullSpaceQP(
        np.hstack([eight.J_tip, still]), np.hstack([eight.J_wrist, still]), eight.v_tip, eight.v_wrist,
        np.r_[eight.grad_mu, 0.0], np.r_[eight.lower, -1.0], np.r_[eight.upper, 1.0], regularization=1e-3,
    )  # fmt: skip
    x = np.r_[solved(eight).x, idle_speed]
    *_, natural, off, _ = judged(nine.row, null_space(nine.A), x)
    assert natural < 1e-6
    assert off == 0.0
    assert asked(nine, null_space(nine.A), Solution(x, None, Status.SOLVED), 9)[0].fault is Fault.NONE


def test_both_ends_of_a_very_short_feasible_segment_are_accepted(qp, Z):
    x, along = solved(qp).x, 1e-4 * Z[0]
    low, high = np.minimum(x - along, x + along), np.maximum(x - along, x + along)
    narrow = NullSpaceQP(
        qp.J_tip, qp.J_wrist, *np.split(qp.A @ x, 2), qp.pull, low, high, regularization=qp.regularization
    )
    for end in (x - along, x + along):
        assert asked(narrow, Z, Solution(end, None, Status.SOLVED))[0].fault is Fault.NONE


@pytest.mark.parametrize("seed", range(5))
def test_idle_joint_is_checked_if_no_other_self_motion_exists(seed):
    """Five independent rows fix five joints. The sixth joint is idle."""
    qp, joints = random_problem(np.random.default_rng(seed)), [0, 1, 2, 3, 4, 6]
    A, x = qp.A[:, joints], 0.5 * (qp.lower + qp.upper)[joints]
    one = NullSpaceQP(*np.split(A, 2), *np.split(A @ x, 2), np.r_[qp.pull[:5], 0.2],
                      qp.lower[joints], qp.upper[joints])  # fmt: skip
    for end, wrong in ((one.lower[5], True), (one.upper[5], False)):
        x[5] = end
        *_, natural, off, opposite = judged(one.row, np.eye(6)[5:], x)
        assert (natural > 0.1) == (off > opposite) == wrong
        assert one.residuals(x).verified() != wrong


@pytest.mark.parametrize("late", LATE)
def test_late_answer_is_replaced_as_the_settings_say(late, qp, Z):
    good = solved(qp)
    other = Solution(good.x + 1e-6, None, Status.SOLVED)
    mine = supervisor(times=[10.0, 3000.0, 2000.0, 10.0], budget_us=2000.0, late=late)
    mine.solve(scripted(good), qp, Z)
    assert (mine.fault, mine.solve_us) == (Fault.NONE, 10.0)
    _, x = mine.solve(scripted(other), qp, Z)
    assert mine.fault is Fault.LATE
    np.testing.assert_array_equal(x, {"hold": good.x, "zero": np.zeros(7), "iterate": other.x}[late])
    mine.solve(scripted(good), qp, Z)
    assert mine.fault is Fault.NONE
    mine.forget()
    solution, x = mine.solve(scripted(Unanswered("late", "nothing after 700 us")), qp, Z)
    assert (mine.fault, solution.status) == (Fault.LATE, Status.TIME_LIMIT)
    assert mine.faults["late"]["first"] == "nothing after 700 us"
    np.testing.assert_array_equal(x, np.zeros(7) if late == "zero" else good.x)


def stoppable(whole, truncated):
    return SimpleNamespace(solve=Mock(return_value=whole), truncated=Mock(side_effect=[truncated]))


@pytest.mark.parametrize(("us", "iterations", "allowed"), [
    (400.0, 40, 10), (1e6, 40, 1), (100.0, 40, None), (400.0, 1, 1), (400.0, 0, None),
])  # fmt: skip
def test_late_solve_is_repeated_with_the_iterations_that_fit_the_budget(us, iterations, allowed, qp, Z):
    whole = solved(qp)._replace(iterations=iterations)
    session = stoppable(whole, whole._replace(x=0.5 * whole.x, status=Status.MAX_ITER))
    mine = supervisor(times=[us], budget_us=100.0, late="iterate")
    solution, x = mine.solve(session, qp, Z)
    assert [one.args[1] for one in session.truncated.call_args_list] == ([] if allowed is None else [allowed])
    assert mine.fault is (Fault.NONE if us <= 100.0 else Fault.LATE)
    np.testing.assert_array_equal(x, whole.x if allowed is None else 0.5 * whole.x)
    assert solution.status is (Status.SOLVED if allowed is None else Status.MAX_ITER)


@pytest.mark.parametrize(("cut", "fault"), [
    (ValueError("cannot stop"), Fault.RAISED), (Solution(np.full(7, 9e3), None, Status.MAX_ITER), Fault.OUTSIDE),
    (Solution(np.full(7, np.nan), None, Status.MAX_ITER), Fault.NOT_FINITE),
])  # fmt: skip
def test_truncated_answer_is_checked_like_any_other(cut, fault, qp, Z):
    mine = supervisor(times=[10.0, 400.0], budget_us=100.0, late="iterate")
    good = solved(qp)
    mine.solve(scripted(good), qp, Z)
    _, x = mine.solve(stoppable(good._replace(iterations=4), cut), qp, Z)
    assert mine.fault is fault
    np.testing.assert_array_equal(x, good.x)


@pytest.mark.parametrize("kind", KINDS)
def test_tip_and_rcm_do_not_depend_on_third_level(kind, robot):
    rng, q, settings = np.random.default_rng(5), robot.data.q_home, ControlSettings.preset("tuned")
    good, bad = (Controller(robot, settings, one) for one in (Exact(), Faulty(Exact(), kind, rate=1.0)))
    references = in_place(robot.state(q), 0.02)
    for mine in (good, bad):
        mine.start(q, np.zeros(7), *references)
    for _ in range(30):
        state = robot.state(q + 1e-4 * rng.normal(size=7), 1e-2 * rng.normal(size=7))
        torques = [mine.tick(state.q, state.v, *references) for mine in (good, bad)]
        assert good.fault is Fault.NONE
        assert bad.fault is not Fault.NONE
        change = state.A @ np.linalg.solve(state.M, torques[1] - torques[0])
        assert np.abs(change).max() < 1e-8
        # both observers get the same torque
        for mine in (good, bad):
            mine.set_applied_torque(torques[0])
    assert np.abs(torques[1] - torques[0]).max() > 1e-3


@pytest.mark.parametrize("name", [name for name, reason in available().items() if reason is None])
def test_at_most_one_percent_of_answers_are_refused(name):
    trace = run(Scenario(solver={"name": name}, **QUICK))
    refused = ("lied", "outside", "late", "not_finite", "malformed", "raised")
    assert np.isin(trace.fault, refused).mean() <= 0.01, trace.meta["faults"]


@pytest.mark.parametrize(("claim", "j", "limit"), [
    (0, 0, "primal_limit"), (0, 1, "primal_limit"), (2, 0, "box_limit"), (2, 1, "box_limit"), (0, 2, "relative_limit"),
    (0, 3, "opposite_limit"), (0, None, "budget_us"),
])  # fmt: skip
def test_answer_with_a_residual_equal_to_its_limit_is_accepted(qp, Z, claim, j, limit):
    """`claim`: 0 for an optimum, 2 for an iterate. `j`: index of the residual in `judged`, None for the solve time."""
    x = opposite(qp).x if j in (2, 3) else np.clip(solved(qp).x, qp.lower, qp.upper)
    x = x + 0.01 * (qp.A[0] if j == 0 else np.where(x == qp.upper, 1.0, 0.0) if j == 1 else 0.0)
    figure = 50.0 if j is None else judged(qp.row, Z, x)[j]
    assert figure > 1e-6
    for share, taken in ((1.0, True), (1.0 - 1e-12, False)):
        made = law(7, **dict.fromkeys(("primal_limit", "box_limit", "relative_limit", "opposite_limit"), np.inf)
                   | {limit: figure * share} | ({"relative_limit": np.inf} if j == 3 else {}))  # fmt: skip
        made.load(qp.row, np.ascontiguousarray(Z))
        assert (made.finish(0, claim, x, 50.0)[0] == 0) == taken


def test_residual_off_is_zero_with_several_self_motions_or_a_faint_gradient(qp):
    """In these two cases, `off` (the distance to the optimum) stays 0 unless the natural residual exceeds 2e-3."""
    faint, several = changed(qp, c2=1e-7, regularization=1e-2), random_problem(np.random.default_rng(3), 8)
    for each, searched in ((qp, True), (faint, False), (several, False)):
        Z = null_space(each.A)
        back = -1e-4 * np.sign(Z[0] @ each.pull) * Z[0]
        found = judged(each.row, Z, solved(each).x + back)
        assert 0.0 < found[2] < 2e-3
        assert (found[3] > 0.0) == searched
