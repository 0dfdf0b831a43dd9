"""The controller of three levels: its torque, fallback and state."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from moc_opt import solvers
from moc_opt.control import Controller, ControlSettings
from moc_opt.control.supervisor import Fault
from moc_opt.errors import ControlError
from moc_opt.solvers import Status
from moc_opt.solvers.exact import Exact
from moc_opt.solvers.isolated import IsolatedSession, Restart
from tests.control.torques import in_place, tracking
from tests.reference.law import third_level

EXACT = solvers.create("exact")
QUIET = {
    "observer_gain_per_s": 0.0, "limit_torque": False, "ramp_s": 0.0, "K_N2": 80.0, "D_N2": 1.0, "feedforward": False,
}  # fmt: skip


def started(robot, solver=EXACT, state=None, **settings):
    state = robot.state(robot.data.q_home) if state is None else state
    law = "dcac" if solver is None else "moc"
    controller = Controller(robot, ControlSettings(law=law, **settings), solver)
    tip_ref, trocar = in_place(state, 0.01)
    controller.start(state.q, state.v, tip_ref, trocar)
    return controller, state, tip_ref, trocar


def test_references_in_any_array_format_are_accepted_if_finite(robot):
    controller, state, tip_ref, trocar = started(robot, None, **QUIET)
    expected = controller.tick(state.q, state.v, tip_ref, trocar)
    for kind in (np.asfortranarray, lambda a: np.repeat(a, 2, axis=1)[:, ::2], lambda a: a.astype(">f8")):
        for given in ((kind(tip_ref), trocar), (tip_ref, kind(trocar))):
            np.testing.assert_array_equal(controller.tick(state.q, state.v, *given), expected)
    for wrong in ((tip_ref * np.nan, trocar), (tip_ref, trocar * np.inf)):
        with pytest.raises(ControlError, match="is not finite"):
            controller.tick(state.q, state.v, *wrong)
    np.testing.assert_array_equal(controller.tick(state.q, state.v, tip_ref, trocar), expected)


@pytest.mark.parametrize("law", ["moc", "dcac"])
def test_torque_is_the_sum_of_the_levels(law, robot, regular_poses):
    K, D = [80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0], [6.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0]
    solver, own = (EXACT, {"K_N2": K, "D_N2": D}) if law == "moc" else (None, {"dcac_damping": D})
    rng = np.random.default_rng(0)
    for q in regular_poses(8):
        state = robot.state(q, rng.uniform(-0.3, 0.3, 7))
        controller, _, tip_ref, trocar = started(robot, solver, state, **{**QUIET, **own})
        tau = controller.tick(state.q, state.v, tip_ref, trocar)
        low = tracking(robot, state, tip_ref, trocar, gains=np.array([3000.0, 80.0, 800.0, 60.0]))
        x = np.zeros(7)
        if solver is not None:
            x = EXACT.start(controller.subproblem).solve(controller.subproblem).x
            np.testing.assert_array_equal(controller.answer, x)
        top = third_level(state, x, np.array(K) * (law == "moc"), np.array(D))
        np.testing.assert_allclose(tau, low + top, rtol=1e-9, atol=1e-8)
        assert np.linalg.norm(top) > 1e-3


def test_third_level_fades_in(robot):
    """With a ramp of ten periods, the first tick gives a tenth of the third level's torque."""
    state = robot.state(robot.data.q_home)
    whole, _, tip_ref, trocar = started(robot, state=state, **QUIET)
    faded, *_ = started(robot, state=state, **{**QUIET, "ramp_s": 0.02})
    dcac, *_ = started(robot, None, state, **QUIET)
    sudden, *_ = started(robot, state=state, **{**QUIET, "ramp_s": 0.001})  # a ramp below the period
    low = dcac.tick(state.q, state.v, tip_ref, trocar)
    top = whole.tick(state.q, state.v, tip_ref, trocar) - low
    np.testing.assert_array_equal(sudden.tick(state.q, state.v, tip_ref, trocar) - low, top)
    for _ in range(2):
        for share in np.append(np.linspace(0.1, 1.0, 10), [1.0, 1.0]):
            found = faded.tick(state.q, state.v, tip_ref, trocar) - low
            np.testing.assert_allclose(found, share * top, atol=1e-9 * np.abs(top).max())
        faded.start(state.q, state.v, tip_ref, trocar)


@pytest.mark.parametrize(("setting", "in_core"), [
    *(({"projector": name}, {"projector": k}) for k, name in enumerate(("dynamic", "static", "as_published"))),
    ({"feedforward": True}, {"feedforward": True}), ({"limit_torque": True}, {"tau_max": None}),
], ids=str)  # fmt: skip
def test_settings_reach_the_core(setting, in_core, robot):
    state = robot.state(robot.data.q_home)
    controller, _, tip_ref, trocar = started(robot, None, state, **{**QUIET, **setting})
    assert controller.solution is controller.subproblem is None
    tip_ref, trocar = tip_ref + 0.3, trocar + np.array([[0.01, 0.0, 0.0], np.zeros(3)])  # torque exceeds tau_max
    given = {name: robot.tau_max if value is None else value for name, value in in_core.items()}
    wanted = tracking(robot, state, tip_ref, trocar, gains=(3000.0, 80.0, 800.0, 60.0), **given)
    np.testing.assert_array_equal(controller.tick(state.q, state.v, tip_ref, trocar), wanted)


@pytest.mark.parametrize("fallback", ["damping", "hold", "least-violation"])
def test_fallback_setting_chooses_x_if_the_subproblem_is_infeasible(fallback, robot):
    """With k0 = 1e-3 /s, a reference at 0.3 m/s makes the subproblem infeasible."""
    state = robot.state(robot.data.q_home, np.linspace(-0.2, 0.2, 7))
    (fast, trocar), (slow, _) = in_place(state, 0.3), in_place(state)
    controller = Controller(robot, ControlSettings(fallback=fallback, k0_per_s=1e-3, **QUIET), EXACT)
    for _ in range(2):  # a start clears earlier answers
        controller.start(state.q, state.v, fast, trocar)
        good = np.zeros(7)
        for tip_ref in (fast, slow, fast, fast, fast):
            tau = controller.tick(state.q, state.v, tip_ref, trocar)
            answer, qp = controller.answer, controller.subproblem
            assert controller.solution.status is (Status.SOLVED if tip_ref is slow else Status.INFEASIBLE)
            if tip_ref is slow:
                good = answer
                assert np.abs(good).max() > 0.0
            elif fallback == "least-violation":
                assert np.linalg.norm(qp.A @ answer - qp.b) < np.linalg.norm(qp.b)
                assert ((answer >= qp.lower) & (answer <= qp.upper)).all()
            else:
                np.testing.assert_array_equal(answer, good if fallback == "hold" else 0.0)
    low = started(robot, None, state, **QUIET)[0].tick(state.q, state.v, fast, trocar)
    np.testing.assert_allclose(tau - low, third_level(state, answer, 80.0, 1.0), atol=1e-8)


def watching(supports=None, error=None):
    """A solver like `exact` that may refuse the problem or fail to start."""
    solver, session = Mock(spec=["name", "supports", "start"]), SimpleNamespace(observe=Mock())
    solver.name, solver.supports.return_value, solver.start.side_effect = "watching", supports, error or [session] * 2
    session.solve = lambda qp: EXACT.start(qp).solve(qp)
    return solver, session


def test_session_observes_the_measured_velocity(robot):
    solver, session = watching()
    controller, state, tip_ref, trocar = started(robot, solver)
    for speed in (0.1, -0.2):
        controller.tick(state.q, np.full(7, speed), tip_ref, trocar)
    seen = [one.args[0][0] for one in session.observe.call_args_list]
    assert seen == [0.0, 0.1, -0.2]  # 0.0 comes from the warm-up


@pytest.mark.parametrize(("wrong", "why"), [
    ({"supports": "it needs regularization = 0"}, "it needs regularization = 0"), ({"supports": 3}, "returned a int"),
    ({"error": RuntimeError("no licence")}, "no licence"), ({"error": [3]}, "a int that has no method `solve`"),
])  # fmt: skip
def test_solver_that_cannot_run_is_named_before_first_tick(robot, wrong, why):
    with pytest.raises(ControlError, match=f"solver 'watching' cannot run in this controller: .*{why}"):
        started(robot, watching(**wrong)[0])


def test_wrong_arguments_are_refused(robot):
    state = robot.state(robot.data.q_home)
    for law, solver, words in (("moc", None, "'moc' with solver None"), ("dcac", EXACT, "'dcac' with solver 'exact'")):
        with pytest.raises(ControlError, match=words):
            Controller(robot, ControlSettings(law=law), solver)
        controller = Controller(robot, ControlSettings(law=law), EXACT if law == "moc" else None)
        with pytest.raises(ControlError, match="call start"):
            controller.tick(state.q, state.v, *in_place(state))
    controller, *_ = started(robot)
    for shapes in (((3,), (2, 3)), ((2, 3), (2, 3)), ((3, 3), (3,)), ((3, 3), (3, 3))):
        with pytest.raises(ControlError, match="has shape"):
            controller.tick(state.q, state.v, *map(np.zeros, shapes))


def test_the_observer_uses_the_limited_torque(robot):
    torques, estimates = [], []
    for limit in (True, False):
        controller, state, tip_ref, trocar = started(robot, limit_torque=limit, observer_gain_per_s=20.0)
        tip_ref[0] += [0.5, 0.5, 0.0]
        torques.append(controller.tick(state.q, state.v, tip_ref, trocar))
        controller.tick(state.q, state.v, tip_ref, trocar)
        estimates.append(controller.external_torque)
    np.testing.assert_array_equal(torques[0], np.clip(torques[1], -robot.tau_max, robot.tau_max))
    cut = torques[1] - torques[0]
    assert np.abs(cut).max() > 10.0
    np.testing.assert_allclose(estimates[1] - estimates[0], -20.0 * 0.002 * cut, atol=1e-9)


def test_run_does_not_depend_on_previous_run(robot):
    controller, other = (Controller(robot, ControlSettings(), EXACT) for _ in range(2))
    home, taus = robot.data.q_home, [[], []]
    tip_ref, trocar = in_place(robot.state(home), 0.01)
    for run in range(2):  # in the second run, another controller ticks in between
        controller.start(home, np.zeros(7), tip_ref, trocar)
        other.start(home, np.zeros(7), tip_ref, trocar)
        for k in range(40):
            taus[run].append(controller.tick(home + 0.001 * k, np.full(7, 0.5 - 0.01 * k), tip_ref, trocar).copy())
            if run == 1:
                other.tick(home - 0.002 * k, np.full(7, -0.3), tip_ref + 0.001, trocar)
    np.testing.assert_array_equal(taus[0], taus[1])
    controller.start(home, np.zeros(7), tip_ref, trocar)
    assert controller.solution is controller.subproblem is None
    assert np.isnan(controller.answer).all()
    np.testing.assert_array_equal(controller.external_torque, 0.0)


class AsAnyOther(Exact):
    """Like `exact`, but called through a session: only the type `Exact` runs inside the core."""


@pytest.mark.parametrize("fallback", ["damping", "hold", "least-violation"])
@pytest.mark.parametrize("speed", [0.02, 3.0], ids=["feasible", "infeasible"])
def test_exact_gives_the_same_bits_inside_the_core_and_through_a_session(robot, speed, fallback):
    rng, settings = np.random.default_rng(3), ControlSettings(fallback=fallback)
    pair = [Controller(robot, settings, solver) for solver in (Exact(), AsAnyOther())]
    for k in range(20):
        state = robot.state(robot.data.q_home + 1e-3 * k, 0.1 * rng.normal(size=7))
        tip_ref, trocar = in_place(state, speed)
        if k == 0:
            for controller in pair:
                controller.start(state.q, state.v, tip_ref, trocar)
        own, other = (controller.tick(state.q, state.v, tip_ref, trocar) for controller in pair)
        np.testing.assert_array_equal(own, other)
        np.testing.assert_array_equal(pair[0].answer, pair[1].answer)
        assert pair[0].subproblem == pair[1].subproblem
        assert repr(pair[0].solution) == repr(pair[1].solution)
    assert pair[0].faults == pair[1].faults
    assert (pair[0].fault is Fault.NONE) == (speed < 1.0)
    noted = [controller.columns(1) for controller in pair]
    for controller, columns in zip(pair, noted, strict=True):
        controller.note(0, columns)
        assert columns.pop("solve_us") == controller.solve_us
        assert columns["fault"] == ["none" if speed < 1.0 else "infeasible"]
        np.testing.assert_array_equal(columns["applied_x_rad_per_s"], [controller.answer])
    for name, column in noted[0].items():
        np.testing.assert_array_equal(column, noted[1][name], err_msg=name)
    assert np.isfinite(noted[0]["dual"]).all() == (speed < 1.0)


def test_controller_reports_when_and_why_a_solver_process_was_replaced(robot):
    session = Mock(spec=IsolatedSession, restarts=[Restart(3, "it hung")], solve=lambda qp: EXACT.start(qp).solve(qp))
    controller, *_ = started(robot, watching(error=[session] * 2)[0])
    assert controller.restarts == [{"at_s": 0.006, "reason": "it hung"}]


def test_warm_up_at_the_start_uses_no_recorded_solve_time(robot):
    settings, state = ControlSettings(supervisor={"budget_us": 20.0}), robot.state(robot.data.q_home)
    controller = Controller(robot, settings, EXACT, times_us=iter([30.0, 10.0, 30.0, 10.0]))
    controller.start(state.q, state.v, *in_place(state))
    for fault in [Fault.LATE, Fault.NONE] * 2:
        controller.tick(state.q, state.v, *in_place(state))
        assert controller.fault is fault


def test_null_space_basis_changes_continuously_with_the_pose(robot):
    controller, state, *task = started(robot)
    end, before = robot.random_regular_pose(np.random.default_rng(4)), None
    for q in np.linspace(state.q, end, 300):
        controller.tick(q, state.v, *task)
        Z = controller.null_space
        np.testing.assert_allclose(Z @ Z.T, np.eye(len(Z)), atol=1e-12)
        np.testing.assert_allclose(controller.state.A @ Z.T, 0.0, atol=1e-12)
        assert before is None or np.abs(Z @ before.T - np.eye(len(Z))).max() < 0.1
        before = Z


def test_writing_into_outputs_does_not_change_controller_state(robot):
    controller, state, tip_ref, trocar = started(robot)
    tau = controller.tick(state.q, state.v, tip_ref, trocar)
    with pytest.raises(ValueError, match="read-only"):
        tau[0] = 0.0
    controller.null_space[:] = 0.0
    controller.external_torque[:] = 100.0
    assert np.abs(controller.null_space).max() > 0.1
    assert np.abs(controller.external_torque).max() < 100.0
