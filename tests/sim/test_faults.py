"""Sensors and injected faults: their effects, times and seeds."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import PlantError, UnknownNameError
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.sim import Measurement, PlantSettings
from moc_opt.sim.faults import GRAVITY, Faults, FaultSettings
from moc_opt.sim.sensors import Encoders, longest_repetition, repeats_no_reading

PERIOD = 0.002
N = 7
SHORT = {"bound_samples": 0, "judge": False, "duration_s": 0.3}
TUNED = {"preset": "tuned"}


def faults(seed=0, **fields):
    return Faults(FaultSettings(**fields), N, PERIOD, seed)


def measured(k):
    return Measurement(np.full(N, float(k)), np.full(N, 0.1 * k), np.zeros(6), k)


def arrived(ticks=60, seed=0, **changes):
    """Return (stamps, q, v) as they arrive. Packet k has q = k and v = 0.1 k."""
    mine = faults(seed, **changes)
    seen = [mine.sense(measured(k), k) for k in range(ticks)]
    return np.array([s.stamp for s in seen]), np.array([s.q for s in seen]), np.array([s.v for s in seen])


def test_no_fault_disturbs_the_arm_by_default():
    np.testing.assert_array_equal(arrived(20)[1][:, 0], np.arange(20.0))
    assert not any(FaultSettings(**only).around_the_arm for only in ({}, {"solver": "lie", "solver_share": 0.5}))
    for field in ("encoder_bias_rad", "drop_share", "bump_N", "payload_kg", "slip_m"):
        assert FaultSettings(**{field: 0.01}).around_the_arm


@pytest.mark.parametrize("field", ["drop_share", "lag_growth", "drift_rad_per_s", "solver_share", "frozen_ticks",
                                   "replay_ticks", "nan_ticks"])  # fmt: skip
def test_fault_setting_outside_its_range_is_refused(field):
    FaultSettings(**{field: 1})
    for beyond in [0] if field.endswith("ticks") else [1.05, -1.05]:
        with pytest.raises(PlantError, match=field):
            FaultSettings(**{field: beyond})


def test_dropped_measurement_is_replaced_by_previous_one():
    stamps, q, v = arrived(500, 1, drop_share=0.4)
    found = q[:, 0]
    np.testing.assert_array_equal(found, stamps)
    np.testing.assert_allclose(v[:, 0], 0.1 * stamps)
    same = np.diff(found) == 0.0
    assert 0.3 < same.mean() < 0.5
    np.testing.assert_array_equal(found[1:][~same], np.arange(1.0, 500.0)[~same])
    assert (arrived(20, drop_share=1.0)[1] == 0.0).all()


@pytest.mark.parametrize("at", [0.006, 0.0051, 0.0069])
def test_encoders_give_nan_for_nan_ticks(at):
    found, first = np.isnan(arrived(20, nan_at_s=at, nan_ticks=4)[1][:, 0]), round(at / PERIOD)
    assert np.flatnonzero(found).tolist() == list(range(first, first + 4))
    assert np.isnan(arrived(20, nan_at_s=at)[1]).sum() == N, "one tick by default"


def test_bias_noise_and_jump_have_the_given_size():
    bias = faults(encoder_bias_rad=0.01).sense(measured(0), 0).q
    np.testing.assert_allclose(np.abs(bias), 0.01)
    noisy = np.array([faults(encoder_noise_rad=0.01, seed=s).sense(measured(0), 0).q for s in range(200)])
    assert noisy.std() == pytest.approx(0.01, rel=0.1)
    jump = arrived(20, jump_at_s=0.01, jump_rad=0.3)[1][:, 0] - np.arange(20.0)
    np.testing.assert_allclose(jump, 0.3 * (np.arange(20) >= 5))
    several = {"drop_share": 0.3, "encoder_noise_rad": 1e-3, "encoder_bias_rad": 1e-3}
    one, again, other = (arrived(20, seed, **several)[1] for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()


@pytest.mark.parametrize(("at", "long"), [(0.02, 0.01), (0.021, 0.01), (0.0199, 0.0003), (0.0, 0.01)])
@pytest.mark.parametrize("link", ["link_4", "tool"])
def test_push_begins_and_ends_at_its_times(link, at, long):
    """Times are rounded to the nearest tick."""
    held, mine = {}, faults(bump_N=30.0, bump_at_s=at, bump_s=long, bump_link=link, payload_kg=2.0)
    plant = SimpleNamespace(push=held.__setitem__)
    weight = np.array([0.0, 0.0, -2.0 * GRAVITY])
    begin, ticks, pushed = round(at / PERIOD), max(1, round(long / PERIOD)), []
    for k in range(30):
        mine.act(plant, k)
        pushed.append(held.get(link, np.zeros(3)) - (weight if link == "tool" else 0.0))
        assert link == "tool" or (held["tool"] == weight).all()
    on = (np.arange(30) >= begin) & (np.arange(30) < begin + ticks)
    np.testing.assert_allclose(np.linalg.norm(pushed, axis=1), 30.0 * on, atol=1e-9)
    np.testing.assert_allclose(np.array(pushed)[:, 2], 0.0, atol=1e-9)


def test_trocar_slips_smoothly():
    t = PERIOD * np.arange(500)
    still = np.zeros((500, 2, 3))
    moved = faults(slip_m=0.01, slip_at_s=0.3).slip(still, t)
    size = np.linalg.norm(moved[:, 0], axis=1)
    assert (size[t <= 0.3] == 0.0).all()
    np.testing.assert_allclose(size[t >= 0.4], 0.01)
    rate = np.gradient(moved[:, 0], PERIOD, axis=0)
    np.testing.assert_allclose(moved[1:-1, 1], rate[1:-1], atol=4e-3)  # rates reach 0.15 m/s
    assert faults().slip(still, t) is still
    ways = np.array([faults(seed, slip_m=0.01, slip_at_s=0.0).slip(still, t)[-1, 0] for seed in range(40)])
    assert (ways[:, :2].min(axis=0) < -0.008).all()
    assert (ways[:, :2].max(axis=0) > 0.008).all()


def test_unknown_link_or_joint_is_refused_before_the_run():
    with pytest.raises(PlantError, match="frozen_joint = 7"):
        faults(frozen_at_s=0.0, frozen_joint=7)
    with pytest.raises(UnknownNameError, match="did you mean 'link_4'"):
        Setup(Scenario(faults={"bump_N": 1.0, "bump_link": "link_44"}, **SHORT))
    Setup(Scenario(faults={"bump_link": "link_44"}, **SHORT))


@pytest.mark.parametrize(("kind", "named"), [
    ("fail", "failed"), ("nan", "not_finite"), ("lie", "lied"), ("raise", "raised"), ("outside", "outside"),
    ("rig", "outside"), ("malformed", "malformed"), ("hang", "late"),
])  # fmt: skip
def test_every_solver_fault_is_named_in_the_trace(kind, named):
    wrong = {"solver": kind, "solver_share": 0.2}
    solver = {"name": "rnn" if kind == "hang" else "exact"}
    scenario = Scenario(control=TUNED, solver=solver, faults=wrong, seed=3, **SHORT)
    trace, setup = run(scenario), Setup(scenario)
    np.testing.assert_array_equal(trace.injected, setup.fault_mask())
    assert 10 < trace.injected.sum() < 50
    np.testing.assert_array_equal(trace.fault, np.where(trace.injected, named, "none"))
    assert {name: found["count"] for name, found in trace.meta["faults"].items()} == {named: trace.injected.sum()}
    if kind == "hang":
        np.testing.assert_array_equal(trace.tau_Nm, run(scenario).tau_Nm)
    assert trace.meta["ended"] == "completed"


def test_hanging_solver_takes_ten_times_the_budget():
    control = {**TUNED, "supervisor": {"budget_us": 7.0, "late": "zero"}}
    scenario = Scenario(control=control, faults={"solver": "hang", "solver_share": 0.5}, **SHORT)
    trace = run(scenario)
    assert not run(scenario.change(control={"law": "dcac"})).injected.any()
    assert set(trace.solve_us) == {0.0, 70.0}
    np.testing.assert_array_equal(trace.fault == "late", trace.solve_us == 70.0)
    assert not trace.applied_x_rad_per_s[trace.fault == "late"].any()


K = np.arange(60)
STUCK = np.where(K < 20, K, 19)


# settings of the fault, arriving packet numbers, arriving positions of joints 1 and 3
@pytest.mark.parametrize(("changes", "stamps", "first", "third"), [
    ({"frozen_ticks": 10}, *[np.where((K < 20) | (K >= 30), K, 19)] * 3),
    ({"frozen_ticks": 10, "forged_stamps": True}, K, *[np.where((K < 20) | (K >= 30), K, 19)] * 2),
    ({"frozen_joint": 0}, K, STUCK, K), ({"frozen_joint": 2}, K, K, STUCK),
    *(({"lag_growth": growth, "late_ticks": 2},
       *[np.maximum(K - 2 - np.floor(growth * np.maximum(K - 19, 0) + 1e-9), 0)] * 3) for growth in (0.1, 1.0)),
    ({"lag_joint": 2, "lag_growth": 1.0, "lag_ticks": 4, "late_ticks": 3}, *[np.maximum(K - 3, 0)] * 2,
     np.maximum(np.where(K < 20, K - 3, 12), 0)),
    ({"replay_ticks": 8}, *[np.r_[:20, np.resize(np.arange(13, 21), 40)]] * 3),
], ids=str)  # fmt: skip
def test_faulty_measurements_arrive_at_their_times(changes, stamps, first, third):
    kind = next(iter(changes)).partition("_")[0]
    frozen = {"frozen_velocity": "zero"} if kind == "frozen" else {}
    found, q, v = arrived(**{f"{kind}_at_s": 0.04}, **frozen, **changes)
    np.testing.assert_array_equal(found, stamps)
    np.testing.assert_array_equal(q[:, 0], first)
    np.testing.assert_array_equal(q[:, 2], third)
    for j, old in ((0, first), (2, third)):
        rests = (old == 19) & (K != 19) if frozen else np.zeros(60, dtype=bool)
        np.testing.assert_allclose(v[:, j], np.where(rests, 0.0, 0.1 * old))


def test_drift_appears_in_position_and_velocity():
    clean, drifting = arrived(), arrived(drift_rad_per_s=0.5, drift_at_s=0.02, seed=3)
    moved, faster = drifting[1] - clean[1], drifting[2] - clean[2]
    assert not moved[:11].any()
    np.testing.assert_allclose(np.abs(faster[11:]), 0.5)
    np.testing.assert_allclose(np.diff(moved[11:], axis=0) / PERIOD, faster[12:], atol=1e-9)
    assert {-1.0, 1.0} == set(np.sign(faster[-1]))


def encoders(seed=0, n=7, *, noise_rad=0.0, resolution_rad=0.0, cutoff_Hz=0.0):
    plant = PlantSettings.nominal(
        period_s=PERIOD, encoder_noise_rad=noise_rad, encoder_resolution_rad=resolution_rad,
        velocity_cutoff_Hz=cutoff_Hz,
    )  # fmt: skip
    return Encoders(plant, np.zeros(n), np.random.default_rng(seed))


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e-2))
@settings(max_examples=50)
def test_readings_are_rounded_to_the_encoders_resolution(seed, step):
    q = np.random.default_rng(seed).uniform(-3, 3, 7)
    position, _ = encoders(resolution_rad=step).start(q, np.zeros(7))
    assert np.abs(position - q).max() <= step / 2 + 1e-12
    steps = position / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_encoder_noise_has_the_given_standard_deviation():
    sensor = encoders(3, noise_rad=1e-4)
    sensor.start(np.zeros(7), np.zeros(7))
    noise = np.array([sensor.read(np.zeros(7), np.zeros(7))[0] for _ in range(3000)])
    np.testing.assert_allclose(noise[:200], 1e-4 * np.random.default_rng(3).standard_normal((256, 7))[1:201])
    assert noise.std() == pytest.approx(1e-4, rel=0.03)
    assert abs(noise.mean()) < 3e-6


def test_velocity_is_the_low_passed_difference_quotient():
    cutoff = 5.0
    sensor = encoders(cutoff_Hz=cutoff)
    q, speed = np.zeros(7), np.linspace(-1, 1, 7)
    sensor.start(q, np.zeros(7))
    estimates = []
    for _ in range(500):
        q = q + PERIOD * speed
        position, velocity = sensor.read(q, speed)
        np.testing.assert_array_equal(position, q)
        estimates.append(velocity)
    rise = 1.0 - np.exp(-2 * np.pi * cutoff * PERIOD * np.arange(1, 501))
    np.testing.assert_allclose(estimates, rise[:, None] * speed, atol=1e-9)


def test_velocity_starts_at_its_true_value():
    sensor = encoders(noise_rad=1e-5)
    first, velocity = sensor.start(np.zeros(7), np.full(7, 0.3))
    np.testing.assert_array_equal(velocity, 0.3)
    second, velocity = sensor.read(np.zeros(7), np.zeros(7))
    np.testing.assert_allclose(velocity, (second - first) / PERIOD, rtol=1e-12, atol=1e-15)


@given(st.floats(2e-6, 1e-4), st.just(0.0) | st.floats(1e-9, 3.0), st.floats(-0.5, 0.5), st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_longest_repetition_bounds_the_equal_readings_of_an_encoder_at_rest(noise, steps, phase, seed):
    step = steps * noise
    longest = longest_repetition(noise, step)
    assert longest is not None
    assert longest >= 10
    sensor = encoders(seed, N := 16, noise_rad=noise, resolution_rad=step)
    q = np.full(N, (1000.0 + phase) * max(step, noise))
    sensor.start(q, 0.0 * q)
    read = np.array([sensor.read(q, 0.0 * q)[0] for _ in range(1500)])
    changes = np.flatnonzero(np.vstack([np.ones((1, N), bool), np.diff(read, axis=0) != 0.0]).T)
    assert np.diff(changes).max() <= longest


@given(st.floats(0.3, 10.0), st.floats(5.0, 400.0), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_an_encoder_with_noise_and_a_velocity_filter_repeats_no_reading(steps, cutoff, seed):
    """The arm moved before, so the filtered velocity begins above zero."""
    noise, step = 1e-5, steps * 1e-5
    sensor = encoders(seed, N := 16, noise_rad=noise, resolution_rad=step, cutoff_Hz=cutoff)
    q = np.full(N, 1000.0 * step)
    sensor.start(q, np.full(N, 1e-3))
    positions, velocities = np.swapaxes([sensor.read(q, 0.0 * q) for _ in range(800)], 0, 1)
    twice = (np.diff(positions, axis=0) == 0.0) & (np.diff(velocities, axis=0) == 0.0)
    if repeats_no_reading(noise, step, cutoff, PERIOD):
        assert not twice.any()


def test_encoder_with_little_noise_may_repeat_a_reading():
    given = [(0.0, 2.4e-5), (3e-6, 2.4e-5), (1e-5, 2.4e-5), (1e-5, 0.0)]
    assert [longest_repetition(noise, step) for noise, step in given] == [None, None, 89, 10]
    # With a cutoff of 10 kHz, the filter changes almost nothing.
    filters = [(1e-5, 50.0), (1e-5, 0.0), (1e-5, 1e4), (0.0, 50.0)]
    promised = [repeats_no_reading(noise, 2.4e-5, cutoff, PERIOD) for noise, cutoff in filters]
    assert promised == [True, False, False, False]
