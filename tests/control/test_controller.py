"""The stack of three levels: what it asks for, what it does when a subproblem has no answer, what it keeps."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from moc_opt import solvers
from moc_opt.control import Controller, ControlSettings, tick
from moc_opt.control.law import packed
from moc_opt.control.null_space import least_violation, null_space
from moc_opt.control.supervisor import Fault, SupervisorSettings
from moc_opt.errors import ControlError
from moc_opt.sim import Plant, PlantSettings
from moc_opt.solvers import Solution, Status
from tests.control.torques import of, subproblem, third, tracking

EXACT = solvers.create("exact")
QUIET = {
    "observer_gain_per_s": 0.0, "limit_torque": False, "ramp_s": 0.0, "K_N2": 80.0, "D_N2": 1.0, "feedforward": False,
}  # fmt: skip


def reference(state, speed=0.01):
    """The tip where it is, moving sideways, and a trocar 0.15 m up the shaft."""
    tip_ref = np.array([state.tip, [speed, 0.0, 0.0], np.zeros(3)])
    return tip_ref, np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])


def started(robot, solver=EXACT, state=None, **settings):
    """A controller after its start, with the references it was started at."""
    state = robot.state(robot.data.q_home) if state is None else state
    law = "dcac" if solver is None else "moc"
    controller = Controller(robot, ControlSettings(law=law, **settings), solver)
    tip_ref, trocar = reference(state)
    controller.start(state, tip_ref, trocar)
    return controller, state, tip_ref, trocar


def infeasible(robot, fallback, **settings):
    """A controller whose box (k0 = 1e-3 /s) is far too narrow for the reference (0.3 m/s)."""
    state = robot.state(robot.data.q_home, np.linspace(-0.2, 0.2, 7))
    controller = Controller(robot, ControlSettings(fallback=fallback, k0_per_s=1e-3, **settings), EXACT)
    tip_ref, trocar = reference(state, speed=0.3)
    controller.start(state, tip_ref, trocar)
    return controller, state, tip_ref, trocar


def test_references_in_any_kind_of_memory(robot):
    state = robot.state(robot.data.q_home, np.linspace(-0.2, 0.2, 7))
    expected = None
    for kind in (np.array, np.asfortranarray, lambda a: np.repeat(a, 2, axis=1)[:, ::2], lambda a: a.astype(">f8")):
        controller, _, tip_ref, trocar = started(robot, state=state, **QUIET)
        tau = controller.tick(state, kind(tip_ref), kind(trocar))
        expected = tau if expected is None else expected
        np.testing.assert_array_equal(tau, expected)


# --- the sum of the levels ---


def test_torque_is_the_sum_of_the_levels(robot, regular_poses):
    rng = np.random.default_rng(0)
    for q in regular_poses(8):
        state = robot.state(q, rng.uniform(-0.3, 0.3, 7))
        controller, _, tip_ref, trocar = started(robot, state=state, **QUIET)
        tau = controller.tick(state, tip_ref, trocar)
        gains = np.array([3000.0, 80.0, 800.0, 60.0])
        low = tracking(state, tip_ref, trocar, gains=gains)
        x = EXACT.start(controller.subproblem).solve(controller.subproblem).x
        Z = null_space(state.A)
        top = state.M @ Z.T @ np.linalg.inv(Z @ state.M @ Z.T) @ Z @ (80.0 * (x - state.v) - state.v)
        np.testing.assert_allclose(tau, low + top, rtol=1e-9, atol=1e-8)
        np.testing.assert_array_equal(controller.answer, x)
        assert np.linalg.norm(top) > 1e-3


def test_gains_of_the_third_level_are_one_per_joint(robot, regular_poses):
    """Joint by joint before the projection: tau_mu = M Z^T (Z M Z^T)^-1 Z (K_N2 * (x - v) - D_N2 * v)."""
    K, D = np.array([80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0]), np.array([6.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0])
    rng = np.random.default_rng(1)
    for q in regular_poses(4):
        state = robot.state(q, rng.uniform(-0.3, 0.3, 7))
        Z, M = null_space(state.A), state.M
        for solver, extra in ((EXACT, {"K_N2": K.tolist(), "D_N2": D.tolist()}), (None, {"dcac_damping": D.tolist()})):
            controller, _, tip_ref, trocar = started(robot, solver, state, **{**QUIET, **extra})
            plain, *_ = started(robot, None, state, **QUIET)
            found = controller.tick(state, tip_ref, trocar) - plain.tick(state, tip_ref, trocar)
            desired = -D * state.v if solver is None else K * (controller.answer - state.v) - D * state.v
            wanted = M @ Z.T @ np.linalg.inv(Z @ M @ Z.T) @ Z @ desired
            np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("extra", [{"K_N2": [1.0, 2.0]}, {"law": "dcac", "dcac_damping": [1.0, 2.0]}])
def test_a_gain_for_each_of_too_few_joints(robot, extra):
    with pytest.raises(ControlError, match=r"(K_N2|dcac_damping) = \(1.0, 2.0\) has 2 entries for 7 joints"):
        Controller(robot, ControlSettings(**extra), None if "law" in extra else EXACT)


def test_dcac_is_the_two_lower_levels(robot):
    controller, state, tip_ref, trocar = started(robot, solver=None, **QUIET)
    tau = controller.tick(state, tip_ref, trocar)
    gains = np.array([3000.0, 80.0, 800.0, 60.0])
    np.testing.assert_array_equal(tau, tracking(state, tip_ref, trocar, gains=gains))
    assert controller.solution is None
    assert controller.subproblem is None
    assert np.isnan(controller.solve_us)
    assert np.isnan(controller.answer).all()


def test_third_level_adds_no_acceleration_of_tip_or_wrist(robot, regular_poses):
    for q in regular_poses(8):
        state = robot.state(q, np.full(7, 0.1))
        moc, _, tip_ref, trocar = started(robot, state=state, **QUIET)
        dcac, *_ = started(robot, None, state, **QUIET)
        difference = moc.tick(state, tip_ref, trocar) - dcac.tick(state, tip_ref, trocar)
        assert np.linalg.norm(difference) > 1e-2
        scale = np.linalg.norm(state.A @ np.linalg.inv(state.M), 2) * np.linalg.norm(difference)
        assert np.linalg.norm(state.A @ np.linalg.solve(state.M, difference)) < 1e-9 * scale


@pytest.mark.parametrize("projector", ["dynamic", "static", "as_published"])
def test_projector_is_a_setting(projector, robot):
    state = robot.state(robot.data.q_home)
    controller, _, tip_ref, trocar = started(robot, None, state, projector=projector, **QUIET)
    trocar = trocar + np.array([[0.01, 0.0, 0.0], np.zeros(3)])
    number = ("dynamic", "static", "as_published").index(projector)
    wanted = tracking(state, tip_ref, trocar, gains=(3000.0, 80.0, 800.0, 60.0), projector=number)
    np.testing.assert_array_equal(controller.tick(state, tip_ref, trocar), wanted)


def test_feedforward_is_a_setting(robot):
    state = robot.state(robot.data.q_home)
    plain, _, tip_ref, trocar = started(robot, None, state, **QUIET)
    fed, *_ = started(robot, None, state, **{**QUIET, "feedforward": True})
    tip_ref[2] = [0.5, 0.0, -0.5]
    extra = fed.tick(state, tip_ref, trocar) - plain.tick(state, tip_ref, trocar)
    np.testing.assert_allclose(state.J_tip @ np.linalg.solve(state.M, extra), tip_ref[2], atol=1e-9)


def test_third_level_fades_in(robot):
    """With a ramp of ten periods the first tick gives a tenth of it; a restart begins anew."""
    state = robot.state(robot.data.q_home)
    whole, _, tip_ref, trocar = started(robot, state=state, **QUIET)
    faded, *_ = started(robot, state=state, **{**QUIET, "ramp_s": 0.02})
    dcac, *_ = started(robot, None, state, **QUIET)
    low = dcac.tick(state, tip_ref, trocar)
    top = whole.tick(state, tip_ref, trocar) - low
    for _ in range(2):
        for share in np.append(np.linspace(0.1, 1.0, 10), [1.0, 1.0]):
            found = faded.tick(state, tip_ref, trocar) - low
            np.testing.assert_allclose(found, share * top, atol=1e-9 * np.abs(top).max())
        faded.start(state, tip_ref, trocar)


def test_speed_fraction_narrows_the_box(robot):
    state = robot.state(robot.data.q_home)
    for fraction in (1.0, 0.25):
        controller, _, tip_ref, trocar = started(robot, state=state, speed_fraction=fraction)
        controller.tick(state, tip_ref, trocar)
        qp = controller.subproblem
        margin = ControlSettings().limit_margin_rad
        below, above = robot.q_min + margin - state.q, robot.q_max - margin - state.q
        np.testing.assert_allclose(qp.upper, np.minimum(fraction * robot.v_max, 2.0 * above))
        np.testing.assert_allclose(qp.lower, np.maximum(-fraction * robot.v_max, 2.0 * below))


@pytest.mark.parametrize("margin", [0.0, 0.045, 0.3])
def test_the_box_closes_before_the_limit(robot, margin):
    """At the margin no joint may move on, between margin and limit it is asked back, and further in it is free."""
    q = robot.data.q_home.copy()
    for joint in range(6):
        for end, side in ((robot.q_min, -1.0), (robot.q_max, 1.0)):
            for inside in (-0.01, 0.0, 0.01):
                pose = q.copy()
                pose[joint] = end[joint] - side * (margin + inside)
                state = robot.state(pose)
                controller, _, tip_ref, trocar = started(robot, state=state, limit_margin_rad=margin, k0_per_s=2.0)
                controller.tick(state, tip_ref, trocar)
                qp = controller.subproblem
                outwards = qp.upper[joint] if side > 0.0 else -qp.lower[joint]
                assert outwards == pytest.approx(2.0 * inside, abs=1e-12)


def test_a_margin_that_leaves_no_room_is_refused(robot):
    with pytest.raises(ControlError, match=r"limit_margin_rad = 2.1: nothing is left of joint 2 .* less than 2.09"):
        Controller(robot, ControlSettings(limit_margin_rad=2.1), EXACT)


@pytest.mark.parametrize("form", ["compiled", "plain"])
def test_the_compiled_parts_of_a_tick_are_their_equations(robot, regular_poses, form):
    """The disturbance is taken out, the basis follows, and the sum is cut at tau_max."""
    rng = np.random.default_rng(1)
    box = np.array([robot.q_min, robot.q_max, robot.v_max])
    parts = {
        "gains": (3000.0, 80.0, 800.0, 60.0), "feedforward": True, "rcm_lambda": 0.4, "limits": box, "k0": 2.0,
        "weights": (0.01, 0.01, 0.001, 1e-5), "K_N2": rng.uniform(10.0, 120.0, 7), "D_N2": rng.uniform(0.0, 5.0, 7),
    }
    law = packed(7, **parts, tau_max=np.full(7, 10.0))
    for q in regular_poses(3):
        state = robot.state(q, rng.uniform(-0.2, 0.2, 7))
        tip_ref, trocar = reference(state)
        Z, row, x, r = null_space(state.A), np.empty(80), rng.normal(size=7), rng.normal(size=7)
        kept = Z.copy()
        tau = of(tick.tracking_torque, form)(state.record, law, tip_ref, trocar, r)
        low = tracking(state, tip_ref, trocar, **parts) - r
        np.testing.assert_allclose(tau, low, rtol=1e-9, atol=1e-9)
        assert of(tick.prepare_third_level, form)(state.record, law, tip_ref, trocar, Z, row)
        np.testing.assert_allclose(row, subproblem(state, tip_ref, trocar, **parts), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(Z, kept, atol=1e-12)
        of(tick.add_third_level, form)(state.record, law, Z, x, 0.6, tau)
        free = low + third(state, Z, x, parts["K_N2"], parts["D_N2"], 0.6)
        assert (np.abs(free) > 10.0).any()
        np.testing.assert_allclose(tau, np.clip(free, -10.0, 10.0), rtol=1e-9, atol=1e-8)


def test_a_warm_up_changes_nothing(robot):
    """Between two ticks, with recorded solve times: what follows is the same to the bit, and no time is used up."""
    state = robot.state(robot.data.q_home, np.linspace(-0.2, 0.2, 7))
    tip_ref, trocar = reference(state)
    seen = []
    for warm in (False, True):
        times, sessions = iter([30.0, 10.0, 30.0, 10.0, 30.0]), []
        solver = Counting(sessions)
        watch = SupervisorSettings(budget_us=20.0)
        controller = Controller(robot, ControlSettings(supervisor=watch), solver, times_us=times)
        controller.start(state, tip_ref, trocar)
        rows = []
        for k in range(4):
            if warm:
                controller.warm_up(robot.state(robot.data.q_home + 0.1), tip_ref, trocar)
            rows.append((controller.tick(state, tip_ref + 1e-3 * k, trocar), controller.solve_us, controller.fault))
            rows[-1] += (controller.null_space, controller.external_torque, controller.answer.copy())
        seen.append((rows, list(times), sessions[0].solved, controller.faults))
    (cold, left, solved, faults), (warmed, *others) = seen
    assert others == [left, solved, faults]
    assert (left, solved) == ([30.0], 4)
    assert [row[2] for row in cold] == [Fault.LATE, Fault.NONE] * 2
    for one, other in zip(cold, warmed, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


class Counting:
    """`exact`; its sessions count their answers."""

    name = "counting"

    def __init__(self, sessions):
        self.sessions = sessions

    def supports(self, qp):
        return None

    def start(self, qp):
        inner = EXACT.start(qp)

        class Session:
            solved = 0

            def solve(self, qp):
                self.solved += 1
                return inner.solve(qp)

        self.sessions.append(Session())
        return self.sessions[-1]


def test_answer_belongs_to_the_tick(robot):
    controller, state, tip_ref, trocar = started(robot)
    controller.tick(state, tip_ref, trocar)
    first = controller.subproblem
    later = robot.state(robot.data.q_home + 0.01, np.full(7, 0.02))
    controller.tick(later, tip_ref, trocar)
    np.testing.assert_array_equal(first.q, state.q)
    np.testing.assert_array_equal(controller.subproblem.q, later.q)
    assert controller.solution.status is Status.SOLVED
    assert 0.0 < controller.solve_us < 1e6


# --- the null space from tick to tick ---


def test_null_space_is_continuous_and_survives_the_straight_elbow(robot):
    q = robot.data.q_home.copy()
    controller, *_ = started(robot, state=robot.state(q))
    before, sizes = None, []
    for angle in np.linspace(0.1, -0.1, 201):
        q[3] = angle
        state = robot.state(q)
        tau = controller.tick(state, *reference(state))
        assert np.isfinite(tau).all()
        Z = controller.null_space
        np.testing.assert_allclose(state.A @ Z.T, 0.0, atol=1e-9)
        np.testing.assert_allclose(Z @ Z.T, np.eye(len(Z)), atol=1e-9)
        if before is not None and len(Z) == len(before) and abs(angle) > 0.01:
            assert np.linalg.norm(Z - before, 2) < 0.1
        before = Z
        sizes.append(len(Z))
    assert sizes[0] == sizes[-1] == 2
    assert max(sizes) == 3  # the straight elbow itself


# --- when the subproblem has no answer ---


def test_without_an_answer_the_null_space_is_damped(robot):
    controller, state, tip_ref, trocar = infeasible(robot, "damping", **QUIET)
    tau = controller.tick(state, tip_ref, trocar)
    assert controller.solution.status is Status.INFEASIBLE
    assert np.isnan(controller.solution.x).all()
    np.testing.assert_array_equal(controller.answer, 0.0)
    dcac = Controller(robot, ControlSettings(law="dcac", **QUIET))
    dcac.start(state, tip_ref, trocar)
    top = tau - dcac.tick(state, tip_ref, trocar)
    Z = null_space(state.A)
    np.testing.assert_allclose(
        top, state.M @ Z.T @ np.linalg.inv(Z @ state.M @ Z.T) @ Z @ (-81.0 * state.v), atol=1e-8
    )
    assert (Z @ np.linalg.solve(state.M, top)) @ (Z @ state.v) < 0.0  # it brakes


def test_without_an_answer_the_last_one_is_held(robot):
    controller, state, tip_ref, trocar = infeasible(robot, "hold")
    controller.tick(state, tip_ref, trocar)
    np.testing.assert_array_equal(controller.answer, 0.0)  # nothing to hold yet
    slow_ref = tip_ref.copy()
    slow_ref[1] = 0.0
    controller.tick(state, slow_ref, trocar)
    assert controller.solution.status is Status.SOLVED
    held = controller.answer.copy()
    assert np.abs(held).max() > 0.0
    for _ in range(3):
        controller.tick(state, tip_ref, trocar)
        assert controller.solution.status is Status.INFEASIBLE
        np.testing.assert_array_equal(controller.answer, held)
    controller.start(state, tip_ref, trocar)
    controller.tick(state, tip_ref, trocar)
    np.testing.assert_array_equal(controller.answer, 0.0)


def test_without_an_answer_the_least_violation_is_taken(robot):
    controller, state, tip_ref, trocar = infeasible(robot, "least-violation")
    controller.tick(state, tip_ref, trocar)
    qp = controller.subproblem
    np.testing.assert_array_equal(controller.answer, least_violation(qp.A, qp.b, qp.lower, qp.upper, 50))
    nothing = np.linalg.norm(qp.b)
    assert np.linalg.norm(qp.A @ controller.answer - qp.b) < nothing
    assert (controller.answer >= qp.lower).all()
    assert (controller.answer <= qp.upper).all()


@pytest.mark.parametrize("fallback", ["damping", "hold", "least-violation"])
def test_an_infeasible_subproblem_does_not_shake_the_tip(robot, fallback):
    controller, state, tip_ref, trocar = infeasible(robot, fallback, **QUIET)
    tau = controller.tick(state, tip_ref, trocar)
    dcac = Controller(robot, ControlSettings(law="dcac", **QUIET))
    dcac.start(state, tip_ref, trocar)
    top = tau - dcac.tick(state, tip_ref, trocar)
    np.testing.assert_allclose(state.A @ np.linalg.solve(state.M, top), 0.0, atol=1e-8)


@dataclass(frozen=True)
class Reusing:
    """A solver that answers out of one buffer, as C libraries do, and fails at every second problem."""

    name: str = "reusing"

    def supports(self, qp):
        """Everything."""
        return None

    def start(self, qp):
        """A session with a buffer for x."""
        return ReusingSession(np.zeros(qp.n))


@dataclass
class ReusingSession:
    """Memory of Reusing."""

    x: np.ndarray
    calls: int = 0
    seen: list = field(default_factory=list)

    def observe(self, v):
        """Note the measured velocity."""
        self.seen.append(v.copy())

    def solve(self, qp):
        """0.1, 0.2, 0.3 ... rad/s, every second one lost."""
        self.calls += 1
        self.x[:] = 0.1 * self.calls if self.calls % 2 else np.nan
        return Solution(self.x, None, Status.SOLVED if self.calls % 2 else Status.NUMERICAL)


def test_held_answer_survives_the_solver_s_own_memory(robot):
    controller, state, tip_ref, trocar = started(
        robot, Reusing(), fallback="hold", supervisor={"check": False}
    )
    answers = []
    for _ in range(4):
        tau = controller.tick(state, tip_ref, trocar)
        assert np.isfinite(tau).all()
        answers.append(controller.answer.copy())
    np.testing.assert_allclose(np.array(answers)[:, 0], [0.1, 0.1, 0.3, 0.3])


def test_a_session_may_watch_the_measured_velocity(robot):
    controller, state, tip_ref, trocar = started(robot, Reusing())
    for speed in (0.1, -0.2):
        controller.tick(robot.state(state.q, np.full(7, speed)), tip_ref, trocar)
    np.testing.assert_array_equal(np.array(controller._session.seen)[:, 0], [0.1, -0.2])


@dataclass(frozen=True)
class Picky(Reusing):
    """A solver that takes no problem with rho."""

    name: str = "picky"

    def supports(self, qp):
        """Only the paper's own problem."""
        return None if qp.regularization == 0.0 else "it needs regularization = 0"


def test_a_solver_that_refuses(robot):
    with pytest.raises(
        ControlError, match="solver 'picky' cannot run in this controller: it needs regularization = 0"
    ):
        started(robot, Picky())
    controller, state, tip_ref, trocar = started(robot, Picky(), regularization=0.0)
    assert np.isfinite(controller.tick(state, tip_ref, trocar)).all()


@pytest.mark.parametrize("at", ["supports", "start"])
@pytest.mark.parametrize("error", [RuntimeError, SystemExit])
def test_a_solver_that_raises_before_the_first_tick(robot, at, error):
    class Boom(Reusing):
        pass

    def misbehave(self, qp):
        raise error("no licence")

    setattr(Boom, at, misbehave)
    words = f"solver 'boom' cannot run in this controller: {error.__name__}: no licence"
    with pytest.raises(ControlError, match=words):
        started(robot, Boom("boom"))


# --- what cannot be ---


def test_law_and_solver_must_match(robot):
    with pytest.raises(ControlError, match="'moc' with solver None; 'moc' needs one"):
        Controller(robot, ControlSettings(law="moc"))
    with pytest.raises(ControlError, match=r"'dcac' with solver 'exact'.*'dcac' takes none"):
        Controller(robot, ControlSettings(law="dcac"), EXACT)


def test_tick_before_start(robot):
    for solver, law in ((EXACT, "moc"), (None, "dcac")):
        controller = Controller(robot, ControlSettings(law=law), solver)
        state = robot.state(robot.data.q_home)
        with pytest.raises(ControlError, match="call start"):
            controller.tick(state, *reference(state))


@pytest.mark.parametrize("shapes", [((3,), (2, 3)), ((2, 3), (2, 3)), ((3, 3), (3,)), ((3, 3), (3, 3))])
def test_references_of_the_wrong_shape(robot, shapes):
    controller, state, *_ = started(robot)
    with pytest.raises(ControlError, match=r"tip_ref has shape .* trocar .*: give \(3, 3\) and \(2, 3\)"):
        controller.tick(state, np.zeros(shapes[0]), np.zeros(shapes[1]))


def test_observer_gain_against_the_period(robot):
    with pytest.raises(ControlError, match="observer_gain_per_s = 300"):
        Controller(robot, ControlSettings(observer_gain_per_s=300.0), EXACT, period=0.01)
    with pytest.raises(ControlError, match="course_observer_gain_per_s = 600"):
        Controller(robot, ControlSettings(third_level="planned", course_observer_gain_per_s=600.0), EXACT, period=0.002)


# --- limits, memory, repetition ---


def test_torque_limits_hold(robot):
    controller, state, tip_ref, trocar = started(robot, limit_torque=True)
    tip_ref[0] += [0.5, 0.5, 0.0]
    tau = controller.tick(state, tip_ref, trocar)
    assert (np.abs(tau) <= robot.tau_max).all()
    assert (np.abs(tau) == robot.tau_max).any()
    free, *_ = started(robot, limit_torque=False)
    desired = free.tick(state, tip_ref, trocar)
    assert (np.abs(desired) > robot.tau_max).any()
    np.testing.assert_array_equal(tau, np.clip(desired, -robot.tau_max, robot.tau_max))


def test_observer_sees_the_limited_torque(robot):
    """The observer is told what is commanded after the cut, or it would wind up against its own limit."""
    torques, estimates = [], []
    for limit in (True, False):
        controller, state, tip_ref, trocar = started(robot, limit_torque=limit, observer_gain_per_s=20.0)
        tip_ref[0] += [0.5, 0.5, 0.0]
        torques.append(controller.tick(state, tip_ref, trocar))
        controller.tick(state, tip_ref, trocar)
        estimates.append(controller.external_torque)
    cut = torques[1] - torques[0]
    assert np.abs(cut).max() > 10.0
    np.testing.assert_allclose(estimates[1] - estimates[0], -20.0 * 0.002 * cut, atol=1e-9)


def test_observer_is_taken_off_the_torque(robot):
    """With an external torque seen, the command is the same law less the estimate."""
    with_one, state, tip_ref, trocar = started(robot, None, **{**QUIET, "observer_gain_per_s": 20.0})
    without, *_ = started(robot, None, **QUIET)
    moving = robot.state(state.q, np.full(7, 0.3))  # a momentum that no torque explains
    difference = with_one.tick(moving, tip_ref, trocar) - without.tick(moving, tip_ref, trocar)
    assert np.abs(with_one.external_torque).max() > 0.1
    np.testing.assert_allclose(difference, -with_one.external_torque, atol=1e-9)
    np.testing.assert_array_equal(without.external_torque, np.zeros(7))


def self_motion_left(robot, damping, ticks=400):
    """Let the arm swing in its null space under DCAC in the nominal plant; what is left of the motion."""
    plant = Plant(robot.data, PlantSettings.nominal(), seed=0)
    state = robot.state(robot.data.q_home)
    swing = null_space(state.A)[0]
    plant.reset(state.q, 0.5 * swing)
    controller, _, tip_ref, trocar = started(
        robot, None, robot.state(plant.q, plant.v), dcac_damping=damping, observer_gain_per_s=0.0
    )
    tip_ref[1] = 0.0
    for _ in range(ticks):
        seen = robot.state(plant.q, plant.v)
        plant.step(controller.tick(seen, tip_ref, trocar), trocar)
    last = robot.state(plant.q, plant.v)
    return float(np.linalg.norm(null_space(last.A) @ last.v)), plant.tip - state.tip


def test_dcac_damping_calms_the_self_motion(robot):
    free, _ = self_motion_left(robot, 0.0)
    damped, drift = self_motion_left(robot, 10.0)
    assert free > 0.2
    assert damped < 0.02 * free
    assert np.linalg.norm(drift) < 1e-3


def drive(robot, controller, ticks=40):
    """Torques along a fixed motion."""
    tip_ref, trocar = reference(robot.state(robot.data.q_home))
    controller.start(robot.state(robot.data.q_home), tip_ref, trocar)
    taus = []
    for k in range(ticks):
        state = robot.state(robot.data.q_home + 0.001 * k, np.full(7, 0.5 - 0.01 * k))
        taus.append(controller.tick(state, tip_ref, trocar).copy())
    return np.array(taus)


def test_deterministic_and_start_forgets(robot):
    controller = Controller(robot, ControlSettings(), EXACT)
    first, again = drive(robot, controller), drive(robot, controller)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, drive(robot, Controller(robot, ControlSettings(), EXACT)))
    state = robot.state(robot.data.q_home)
    controller.start(state, *reference(state))
    assert controller.solution is None
    assert controller.subproblem is None
    assert np.isnan(controller.answer).all()
    np.testing.assert_array_equal(controller.external_torque, 0.0)


def test_two_controllers_share_no_state(robot):
    alone = drive(robot, Controller(robot, ControlSettings(), EXACT))
    one, other = (Controller(robot, ControlSettings(), EXACT) for _ in range(2))
    tip_ref, trocar = reference(robot.state(robot.data.q_home))
    for controller in (one, other):
        controller.start(robot.state(robot.data.q_home), tip_ref, trocar)
    taus = []
    for k in range(40):
        state = robot.state(robot.data.q_home + 0.001 * k, np.full(7, 0.5 - 0.01 * k))
        taus.append(one.tick(state, tip_ref, trocar).copy())
        elsewhere = robot.state(robot.data.q_home - 0.002 * k, np.full(7, -0.3))
        other.tick(elsewhere, tip_ref + 0.001, trocar)
    np.testing.assert_array_equal(alone, taus)


def test_what_is_handed_out_cannot_be_written_back(robot):
    controller, state, tip_ref, trocar = started(robot)
    tau = controller.tick(state, tip_ref, trocar)
    with pytest.raises(ValueError, match="read-only"):
        tau[0] = 0.0
    controller.null_space[:] = 0.0
    controller.external_torque[:] = 100.0
    assert np.abs(controller.null_space).max() > 0.1
    assert np.abs(controller.external_torque).max() < 100.0


def test_inputs_are_left_alone(robot):
    controller, state, tip_ref, trocar = started(robot)
    kept = tip_ref.copy(), trocar.copy(), state.record.copy()
    controller.tick(state, tip_ref, trocar)
    for now, before in zip((tip_ref, trocar, state.record), kept, strict=True):
        np.testing.assert_array_equal(now, before)
