"""The safety filter reacts to a value above a threshold, but not at it. All numbers are short binary fractions."""

import numpy as np
import pytest

from moc_opt import core

T, OFF, ZERO, NO_WRENCH = 2.0**-9, np.inf, np.zeros(2), np.full(6, np.nan)
JOINT = np.concatenate([np.eye(3).ravel(), np.zeros(3), [0.0, 0.0, 1.0], np.zeros(11), [1.0]])[None]
POINTS = np.array([[0.0] * 3, [0.0, 0.0, -0.25]])
ARM = core.Arm(np.vstack([JOINT, JOINT]), POINTS, np.eye(3), np.ones((2, 2)), np.zeros(3))  # two massless joints
LOADED = np.vstack([JOINT, np.concatenate([JOINT[0, :16], [1.0, 0.5, 0.0, 0.0], JOINT[0, 20:]])])  # second link: 1 kg
TROCAR = np.array([[0.0, 0.0, -0.125], [0.0] * 3])


def begun(arm=ARM, **levels):
    """A safety filter of an arm at rest. Only the thresholds ``levels`` are switched on."""
    given = {
        "period": T, "patience": 0, "carries": False, "low": -1e9, "high": 1e9, "v_max": 1.0, "tau_max": 1.0,
        "wall_stiffness": 0.0, "wall_damping": 0.0, "wall_brake": 1.0, "torque_step": OFF, "jump": OFF,
        "speed_factor": OFF, "tip_error": OFF, "tip_share": 1.0, "in_incision": True, "warning": [OFF, OFF],
        "limit": [OFF, OFF], "incision_share": 1.0, "tool_mass": 0.0, "tool_length": 0.25, "tip_force": OFF,
        "stop_holding": 0.25, "stop_yield": OFF, "stop_yield_ticks": 9, "press_share": 1.0, "motion": True,
        "motion_s": 1e9, "motion_rad": OFF, "motion_lag_s": 0.0, "repeat_m": OFF, "repeat_torque": OFF,
        "repeat_whole_m": OFF, "repeat_whole_torque": OFF, "repeat_whole_ticks": OFF, "repeat_joint_ticks": OFF,
        "repeat_reading_ticks": OFF, "replayed_ticks": OFF, "stuck_speed": OFF, "held": 0.0, "residual_torque": OFF,
        "residual_whole": OFF, "residual_rate": 16.0, "residual_share": 0.0, "settling_ticks": 0, **levels,
    }  # fmt: skip
    for name in ("low", "high", "v_max", "tau_max", "held", "warning", "limit"):
        given[name] = np.broadcast_to(np.asarray(given[name], float), (2,)).copy()
    made = core.Guard(arm, **given)
    made.start(ZERO, ZERO, 0)
    return made


def read(guard, q=0.0, v=0.0, applied=0.0, wrench=NO_WRENCH, trocar=None, other=0.0):
    """Return the reason to stop after one reading."""
    tau = np.array([applied, 0.0])
    return core.REASONS[guard.believe(np.array([q, other]), np.array([v, 0.0]), np.nan, tau, wrench, trocar)[0]]


def follow(guard, before=0.0, tip=None, tip_ref=None, record=None, other=0.0):
    tip_ref = None if tip_ref is None else np.array([[tip_ref, 0.0, 0.0], *np.zeros((2, 3))])
    tip = None if tip is None else np.array([tip, 0.0, 0.0])
    return core.REASONS[guard.follow(ZERO, ZERO, record, tip, tip_ref, np.array([before, other]), np.zeros(2))[0]]


def pressed(force):
    """Return the wrench while the trocar presses on the shaft along x, and an equal force at the tip opposes it."""
    return np.array([0.0, 0.0, 0.0, 0.0, -0.125 * force, 0.0])


def unbelieved(level, name, q, v):
    guard = begun(**{name: level})
    read(guard, q=q, v=v)
    return guard.watched()[0]


def tip_error(level, tip):
    return "tip" in follow(begun(tip_error=level), tip=tip, tip_ref=0.25, record=ARM.terms(ZERO, ZERO))


def moved_too_far(level, name="motion_rad", v=0.0):
    guard = begun(**{name: level}, **{"motion_rad": 0.0} if v else {})
    read(guard, v=v)
    return "velocities" in read(guard, q=0.25 + T * v, v=v)


def frozen(level, name, wrench, applied, tip, **others):
    """Whether a fourth equal reading stops the arm, if the torque or the tip's reference changed after the third."""
    guard = begun(**{name: level} | others)
    for _ in range(3):
        follow(guard, tip=0.25, tip_ref=0.25)
        assert read(guard, applied=0.25, wrench=wrench) == "running"
    follow(guard, tip=tip, tip_ref=tip)
    return "all encoders" in read(guard, applied=applied, wrench=wrench)


def waits(level):
    return frozen(level, "patience", NO_WRENCH, 0.5, 0.25, repeat_torque=0.0)


def not_believed(level):
    guard = begun(jump=0.0, patience=level)
    return [read(guard, q=1.0) for _ in range(3)][-1] == "measurements not believed"


def replayed(level, name, drift):
    """Whether the arm stops if the first eight of 20 readings are repeated. With `drift`, joint 2 does not repeat."""
    guard = begun(**{name: level})
    return [read(guard, q=k % 20, other=k % 20 + drift * k, wrench=np.zeros(6)) for k in range(28)][-1] != "running"


def repeated(level, name, v=0.0, wrench=lambda k: NO_WRENCH, drift=0.0):
    """Whether the arm stops at nine equal readings after 99 different ones. With `drift`, joint 2 does not repeat."""
    guard = begun(**{name: level})
    for k in range(99):
        read(guard, q=k * T, v=v * k, wrench=wrench(k), other=k * T)
    return [read(guard, q=9.0, v=v, wrench=wrench(101), other=9.0 + drift * k) for k in range(9)][-1] != "running"


def incision(level, j, name, shown):
    guard = begun(**{name: [level if i == j else OFF for i in range(2)]})
    beside = np.array([[0.25 * (1 - j), 0.0, 0.0], [0.0] * 3])
    reason = read(guard, wrench=pressed(0.25 * j), trocar=TROCAR + beside)
    return reason != "running" if shown == "stop" else guard.watched()[1][2, j] == 0.0


def touched(level):
    guard = begun(warning=[OFF, level])
    read(guard, wrench=np.array([0.25, 0.0, 0.0, 0.0, 0.0625, 0.0]), trocar=TROCAR)
    return guard.watched()[1][2, 1] == 0.0


def residual(level, name, repeats=0, **others):
    """Whether the arm stops if a torque of 1 Nm does not move joint 1."""
    guard, record = begun(**{name: level} | others), ARM.terms(ZERO, ZERO)
    for _ in range(2 + repeats):
        read(guard)
    return [follow(guard, 1.0, record=record) for _ in range(2)][-1] != "running"


def settles(level, name):
    return residual(level, name, residual_torque=0.0)


def yields(level):
    guard = begun(stop_yield=level)
    read(guard, wrench=pressed(0.0), trocar=TROCAR)
    return guard.hold(pressed(0.25))[0] == 0.0


def stays_open(level):
    """Whether open brakes stay open if the force falls to 0.125 N, half of stop_yield = 0.25 N."""
    guard = begun(stop_yield=level)
    read(guard, wrench=pressed(0.0), trocar=TROCAR)
    assert guard.hold(pressed(0.5))[0] == 0.0
    return guard.hold(pressed(0.125))[0] == 0.0


@pytest.mark.parametrize(("noticed", "level", "more"), [
    (unbelieved, 0.25, ("jump", 0.25 + T, 0.0)), (unbelieved, 0.25, ("speed_factor", 0.0, 0.25)),
    (tip_error, 0.25, (None,)), (tip_error, 0.125, (0.125,)), (waits, 3, ()), (not_believed, 3, ()),
    (moved_too_far, 0.25, ()), (moved_too_far, 0.25, ("motion_lag_s", 1.0)), (touched, 0.25, ()),
    (frozen, 0.25, ("repeat_m", NO_WRENCH, 0.25, 0.5)), (frozen, 0.25, ("repeat_torque", NO_WRENCH, 0.5, 0.25)),
    (frozen, 0.25, ("repeat_whole_m", np.zeros(6), 0.25, 0.5)), (settles, 2, ("settling_ticks",)),
    (frozen, 0.25, ("repeat_whole_torque", np.zeros(6), 0.5, 0.25)), (settles, 1, ("patience",)),
    (replayed, 8, ("replayed_ticks", 0.0)), (replayed, 8, ("repeat_reading_ticks", T)),
    *((repeated, 8, (*name, drift)) for drift in (0.0, T) for name in (
        ("repeat_joint_ticks", 0.0, lambda k: NO_WRENCH), ("repeat_reading_ticks", 1.0, lambda k: NO_WRENCH),
        ("repeat_whole_ticks", 0.0, lambda k: np.full(6, k + 1.0)))),
    *((incision, 0.25, (j, *name)) for j in range(2) for name in (("limit", "stop"), ("warning", "warns"))),
    (residual, 16.0 * T, ("residual_torque",)), (residual, 16.0 * T, ("residual_whole",)),
    (residual, 16.0 * T * T, ("stuck_speed", 2)), (yields, 0.25, ()), (stays_open, 0.25, ()),
])  # fmt: skip
def test_only_a_value_above_its_threshold_is_noticed(noticed, level, more):
    assert not noticed(level, *more)
    assert noticed(level * (1.0 - 2.0**-40), *more)


@pytest.mark.parametrize(("torques", "carries"), [((1.5, 1.5), 0.0), ((-0.5, -0.5), 0.0), ((1.5, 0.0), 0.5)])
def test_torque_in_a_stop_is_zero_if_the_residual_opposes_the_commanded_torque(torques, carries):
    """In case 3, joint 1's last torque is 0, so no residual can oppose it, and the drives carry the weight, 0.5 Nm."""
    arm = core.Arm(LOADED, np.zeros((2, 3)), np.eye(3), np.ones((2, 2)), np.array([0.0, -1.0, 0.0]))
    guard, record = begun(arm, residual_torque=2.0**-8, carries=True, patience=1), arm.terms(ZERO, ZERO)
    read(guard)
    reasons = [follow(guard, before, record=record, other=0.5) for before in (0.5, *torques)]
    assert [reason.startswith("the measured motion does not") for reason in reasons] == [False, False, True]
    np.testing.assert_array_equal(guard.rest(ZERO), carries)


def test_motion_at_constant_speed_needs_no_torque():
    guard, record = begun(residual_torque=2.0**-9), ARM.terms(ZERO, ZERO + 0.5)
    assert [follow(guard, record=record) for _ in range(4)] == ["running"] * 4


def test_velocities_may_lag_behind_positions_only_shortly_after_fast_motion():
    for still, reason in ((1, "running"), (12, "velocities")):
        guard = begun(motion_s=4.0 * T, motion_rad=0.0, motion_lag_s=1.0)
        assert [read(guard, v=float(k == 0)) for k in range(still + 1)] == ["running"] * (still + 1)
        assert reason in read(guard, q=0.25)


def test_closed_brakes_open_again_if_the_force_rises_by_stop_yield():
    """The rise is measured from the lowest force after the brakes closed."""
    guard = begun(stop_yield=0.25, stop_yield_ticks=2)
    read(guard, wrench=pressed(0.0), trocar=TROCAR)
    opened = {0.25: 0, 1.0: 1, 1.125: 1, 0.9375: 0, 1.1875: 0, 1.25: 1, 0.875: 0, 0.5: 0, 0.75: 0, 0.8125: 1}
    assert [guard.hold(pressed(force))[0] == 0.0 for force in opened] == list(map(bool, opened.values()))


def test_brakes_stay_closed_if_drives_cannot_carry_the_weight():
    arm = core.Arm(LOADED, POINTS, np.eye(3), np.ones((2, 2)), np.array([0.0, -1.0, 0.0]))
    for tau_max, opened in ((0.5, True), (0.5 - T, False)):  # the weight is 0.5 Nm
        guard = begun(arm, carries=True, tau_max=tau_max, stop_yield=0.25)
        read(guard, wrench=pressed(0.0), trocar=TROCAR)
        assert (guard.hold(pressed(1.0))[0] == 0.0) == opened
