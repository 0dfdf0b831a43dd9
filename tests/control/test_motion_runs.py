"""Frozen, late, repeated and drifting measurements in whole runs: stopped, how soon, and what it costs."""

import numpy as np
import pytest

from moc_opt.scenario import Scenario, run, steps
from moc_opt.sim import Plant

QUICK = {"bound_samples": 0, "judge": False}
SMALL = {"task": {"path": "circle", "sizes": {"radius": 0.003}}}
LAWS = {"tuned": {"preset": "tuned"}, "dcac": {"law": "dcac"}, "c": {"backend": "c"}}


def stopped(trace, at_s):
    """How long after its cause the stop was ordered [s]."""
    assert trace.meta["ended"].startswith("stopped: "), trace.meta["ended"]
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.02
    return trace.meta["stopped_at_s"] - at_s


def excursion(trace):
    """Largest tip error up to the stop, and way of the tip from there, which is not meant to follow any more [m]."""
    stop = trace.t_s >= trace.meta["stopped_at_s"]
    coast = np.linalg.norm(trace.tip_m[stop] - trace.tip_m[stop][0], axis=1).max()
    return trace.tip_error_registered_m[~stop].max(initial=0.0), coast


def force(trace):
    return np.linalg.norm(trace.trocar_force_N, axis=1)


@pytest.mark.parametrize("control", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("task", [SMALL, {}], ids=["small", "circle"])
@pytest.mark.parametrize("faults", [{"drop_share": 1.0}, {"frozen_at_s": 0.9}], ids=["all-dropped", "frozen"])
def test_packets_that_stop_stop_the_arm(control, task, faults):
    """On a circle of 3 mm as on any: the errors that such a measurement shows stay below every limit on errors."""
    scenario = Scenario(control=control, faults=faults, duration_s=2.0, **task, **QUICK)
    trace = run(scenario)
    patience = scenario.guard.patience_ticks * scenario.plant.period_s
    assert stopped(trace, faults.get("frozen_at_s", 0.0)) <= patience + 2 * scenario.plant.period_s
    assert "3 ticks late" in trace.meta["ended"]
    error, coast = excursion(trace)
    assert error < 2.5e-3
    assert coast < 1e-3
    assert force(trace).max() < 3.0


@pytest.mark.parametrize("late", range(4))
@pytest.mark.parametrize("law", ["dcac", "moc"])
def test_a_constant_delay_stops_nothing(law, late):
    control = {"preset": "robust", "law": law}
    trace = run(Scenario(control=control, faults={"late_ticks": late}, plant={"delay_ticks": 0}, **QUICK))
    assert trace.meta["ended"] == "completed"


@pytest.mark.parametrize("late", [0, 2])
@pytest.mark.parametrize("at", [0.1, 1.3])
def test_a_short_gap_is_bridged(at, late):
    base = Scenario(control={"preset": "robust"}, faults={"late_ticks": late}, duration_s=2.0, **QUICK)
    clean, gap, longer = (
        run(base.change(faults={} if ticks == 0 else {"frozen_at_s": at, "frozen_ticks": ticks})) for ticks in (0, 3, 4)
    )
    assert clean.meta["ended"] == gap.meta["ended"] == "completed"
    assert np.abs(gap.tip_m - clean.tip_m).max() < 2e-4
    assert stopped(longer, at) <= 0.01


@pytest.mark.parametrize("growth", [0.05, 0.3])
def test_a_lag_that_grows_is_stopped(growth):
    trace = run(Scenario(faults={"lag_at_s": 1.0, "lag_growth": growth}, duration_s=2.0, **QUICK))
    assert stopped(trace, 1.0) < 5 / growth * 0.002
    assert force(trace).max() < 3.0


def test_packets_of_the_past_are_not_believed():
    trace = run(Scenario(faults={"replay_at_s": 1.0, "replay_ticks": 200}, duration_s=2.0, **QUICK))
    assert stopped(trace, 1.0) <= 0.01
    assert force(trace).max() < 3.0


@pytest.mark.parametrize("plant", [{}, {"force_noise_N": 0.0, "torque_noise_Nm": 0.0}], ids=["noisy", "quiet-wrench"])
@pytest.mark.parametrize("backend", ["python", "c"])
@pytest.mark.parametrize(("seed", "ticks"), [(8316, 80), (8307, 80), (8310, 80)])
def test_a_recording_of_the_resting_arm_is_seen_through(seed, ticks, backend, plant):
    """It agrees with its own velocities and with the model; that its noise came before is the only sign."""
    scenario = Scenario(
        seed=seed, start={"pose": "random"}, control={"preset": "tuned", "backend": backend}, duration_s=6.0, **QUICK,
        task={"path": "line", "sizes": {"length": 0.02}, "wait_s": 0.2, "hold_s": 10.0},
        faults={"replay_at_s": 4.0, "replay_ticks": ticks, "forged_stamps": True}, plant=plant,
    )  # fmt: skip
    trace = run(scenario)
    # A reading of one encoder or of all of them, whichever is the first to be known again.
    known = ("stopped: the measurements are a recording", "stopped: one encoder lags")
    assert trace.meta["ended"].startswith(known)
    assert stopped(trace, 4.0) < 0.08
    error, coast = excursion(trace)
    assert max(error, coast) < 2e-3
    assert force(trace).max() < 5.0


@pytest.mark.parametrize("velocity", ["repeated", "zero"])
@pytest.mark.parametrize("seed", range(4))
def test_frozen_readings_with_forged_numbers_are_seen_through(seed, velocity):
    """Poses and moments that no level was chosen on; small tasks and large ones."""
    rng = np.random.default_rng(100 + seed)
    at = float(rng.uniform(0.0, 2.5))
    task = {"path": str(rng.choice(["line", "spiral"])), "v_max_m_per_s": float(rng.uniform(0.01, 0.1))}
    faults = {"frozen_at_s": at, "forged_stamps": True, "frozen_velocity": velocity}
    trace = run(Scenario(
        seed=500 + seed, start={"pose": "random", "swivel": "random"}, faults=faults, task=task, duration_s=4.0, **QUICK
    ))  # fmt: skip
    assert stopped(trace, at) < 0.1
    error, coast = excursion(trace)
    assert error < 4e-3
    assert coast < 4e-3
    assert force(trace).max() < 5.0


@pytest.mark.parametrize("velocity", ["repeated", "zero"])
@pytest.mark.parametrize(("robot", "backend"), [("lwr4", "c"), ("panda", "python"), ("lwr4_rail", "python")])
def test_one_stuck_encoder_is_found_by_its_velocity_after_the_patience(robot, backend, velocity):
    """A filtered velocity dies out while the position stays: it never repeats itself too. 31 mm and 24 N without."""
    rng = np.random.default_rng(2110)
    for joint in range(7):
        at = float(rng.uniform(0.3, 1.5))
        faults = {"frozen_at_s": at, "frozen_joint": joint, "frozen_velocity": velocity}
        trace = run(Scenario(
            seed=int(rng.integers(2000, 3000)), robot={"name": robot}, start={"pose": "random"}, faults=faults,
            control={"backend": backend}, duration_s=at + 0.1, **QUICK,
        ))  # fmt: skip
        assert trace.meta["ended"].startswith("stopped: ")
        assert trace.meta["stopped_at_s"] - at <= 0.012
        assert force(trace).max() < 6.0
        assert max(excursion(trace)) < 0.012


@pytest.mark.parametrize("task", ["still", "circle"])
@pytest.mark.parametrize("robot", ["lwr4", "iiwa14", "gen3", "xarm7"])
def test_a_lag_under_forged_numbers_repeats_readings(robot, task):
    """It grows by a reading that comes twice, at rest as in motion, from the first tick on: 57 mm without."""
    rng = np.random.default_rng(2120)
    still = {"path": "line", "sizes": {"length": 0.0005}, "wait_s": 0.2, "hold_s": 10.0}
    for at in (0.0, 0.05, float(rng.uniform(0.3, 1.0))):
        growth = float(rng.uniform(0.05, 1.0))
        trace = run(Scenario(
            seed=int(rng.integers(2000, 3000)), robot={"name": robot}, start={"pose": "random"},
            control={"law": "dcac"}, task=still if task == "still" else {}, duration_s=1.5, **QUICK,
            faults={"lag_at_s": at, "lag_growth": growth, "forged_stamps": True},
        ))  # fmt: skip
        # Before the arm moves no velocity is other than zero, and no lag does harm.
        assert trace.meta["stopped_at_s"] - max(at, 0.1) < 5 / growth * 0.002 + 0.1
        assert force(trace).max() < 5.0
        assert max(excursion(trace)) < 4e-3


@pytest.mark.parametrize("robot", ["lwr4", "gen3", "xarm7"])
def test_a_lag_of_one_encoder_repeats_its_readings(robot):
    """A reading of it comes twice now and then: of twelve runs four completed without, one ended at 53 mm."""
    rng = np.random.default_rng(2130)
    for joint in range(7):
        at, growth = float(rng.uniform(0.3, 1.0)), float(rng.uniform(0.05, 0.5))
        faults = {"lag_at_s": at, "lag_growth": growth, "lag_joint": joint}
        trace = run(Scenario(
            seed=int(rng.integers(2000, 3000)), robot={"name": robot}, start={"pose": "random"}, faults=faults,
            duration_s=at + 0.4, **QUICK,
        ))  # fmt: skip
        assert trace.meta["ended"].startswith("stopped: ")
        assert trace.meta["stopped_at_s"] - at < 5 / growth * 0.002 + 0.01
        assert force(trace).max() < 6.0
        assert max(excursion(trace)) < 0.012


@pytest.mark.parametrize("robot", ["lwr4", "gen3", "xarm7"])
def test_one_encoder_that_lags_from_one_tick_to_the_next_shows_old_readings(robot):
    """It repeats none twice in a row: of twelve runs five completed without, one at 48 mm and 17 N."""
    rng = np.random.default_rng(2150)
    for joint in range(7):
        at, ticks = float(rng.uniform(0.3, 1.0)), int(rng.integers(8, 41))
        faults = {"lag_at_s": at, "lag_ticks": ticks, "lag_growth": 1e-6, "lag_joint": joint}
        trace = run(Scenario(
            seed=int(rng.integers(2000, 3000)), robot={"name": robot}, start={"pose": "random"}, faults=faults,
            duration_s=at + 0.2, **QUICK,
        ))  # fmt: skip
        assert trace.meta["ended"].startswith("stopped: ")
        assert trace.meta["stopped_at_s"] - at < 0.03
        assert force(trace).max() < 6.0
        assert max(excursion(trace)) < 0.004


@pytest.mark.parametrize("robot", ["lwr4", "xarm7"])
def test_a_frozen_wrench_sensor_does_not_hide_a_slip(robot):
    """Where it froze before the trocar slipped the run completed, with 34 N and 61 mm."""
    faults = {"frozen_at_s": 0.4, "frozen_wrench": True, "slip_m": 0.1, "slip_at_s": 0.8}
    trace = run(Scenario(seed=2140, robot={"name": robot}, faults=faults, duration_s=1.5, **QUICK))
    assert trace.meta["ended"].startswith("stopped: the wrench sensor repeats its reading")
    assert trace.meta["stopped_at_s"] == pytest.approx(0.452, abs=0.004)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("seed", [2100, 2101])
def test_one_stuck_encoder_is_found_by_its_noise_at_the_latest(joint, seed):
    """After as many ticks as its noise lets it repeat itself: before that check 204 mm and 61 N."""
    at = float(np.random.default_rng([seed, joint]).uniform(0.5, 2.0))
    faults = {"frozen_at_s": at, "frozen_joint": joint, "frozen_velocity": "zero"}
    scenario = Scenario(
        seed=seed, start={"swivel": "random"}, faults=faults, duration_s=3.0, guard={"repeat_reading_ticks": 10**6},
        **QUICK,
    )  # fmt: skip
    trace = run(scenario)
    assert stopped(trace, at) <= 0.002 * (scenario.told_guard.repeat_joint_ticks + 2)
    assert force(trace).max() < 25.0
    assert max(excursion(trace)) < 0.045


@pytest.mark.parametrize("joint", [0, 1, 3, 5])
def test_a_stuck_encoder_without_noise_is_found_by_its_momentum_or_felt(joint):
    """At the latest the trocar's force stops it: not before tens of millimetres."""
    faults = {"frozen_at_s": 1.2, "frozen_joint": joint, "frozen_velocity": "zero"}
    scenario = Scenario(faults=faults, plant={"encoder_noise_rad": 0.0}, duration_s=4.0, **QUICK)
    blind = run(scenario.change(guard={"motion": False, "trocar_force_N": None, "rcm_error_m": None}))
    trace = run(scenario)
    assert stopped(trace, 1.2) < 1.5
    assert force(trace).max() < 32.0
    error, coast = excursion(trace)
    assert max(error, coast) < 0.1
    assert error < 0.8 * blind.tip_error_registered_m.max()


@pytest.mark.parametrize("rate", [0.02, 0.05])
@pytest.mark.parametrize("seed", range(2200, 2203))
def test_a_drift_that_the_velocity_shares_is_felt_at_the_trocar_alone(seed, rate):
    """The model agrees with drifting encoders: what the arm feels is the only sign."""
    faults = {"drift_rad_per_s": rate, "drift_at_s": 0.5}
    trace = run(Scenario(seed=seed, start={"swivel": "random"}, faults=faults, duration_s=6.0, **QUICK))
    assert "the trocar's force" in trace.meta["ended"] or (rate < 0.05 and trace.meta["ended"] == "completed")
    assert force(trace).max() < 32.0
    assert trace.tip_error_m[trace.t_s <= trace.meta.get("stopped_at_s", np.inf)].max() < 0.13


def test_a_drift_that_draws_the_tip_out_of_the_incision_is_felt_by_the_whole_force():
    """At the believed depth its force passes for a touch of the tip: 223 mm and 85 N, to the end of the run."""
    scenario = Scenario(
        seed=7033, start={"swivel": "random"}, control={"preset": "robust"},
        task={"v_max_m_per_s": 0.07730648346067734}, duration_s=6.0, **QUICK,
        faults={"drift_at_s": 2.02, "drift_rad_per_s": 0.05},
    )  # fmt: skip
    # Nor by the momentum residual, which such a force ends up in.
    blind = run(scenario.change(guard={"tip_force_N": None, "residual_whole_torque": 1e6}))
    trace = run(scenario)
    assert blind.meta["ended"] == "completed"
    assert force(blind).max() > 80.0
    assert "the trocar's force" in trace.meta["ended"]
    assert force(trace).max() < 32.0
    assert max(excursion(trace)) < 0.13


@pytest.mark.parametrize("seed", range(2210, 2213))
def test_a_drift_against_a_velocity_that_is_measured_apart_is_seen(seed):
    faults = {"drift_rad_per_s": 0.05, "drift_at_s": 0.5, "drift_velocity": "apart"}
    trace = run(Scenario(seed=seed, start={"swivel": "random"}, faults=faults, duration_s=2.0, **QUICK))
    assert "do not follow their velocities" in trace.meta["ended"]
    assert stopped(trace, 0.5) < 0.1
    assert max(excursion(trace)) < 5e-3


@pytest.mark.parametrize(("robot", "joint"), [("lwr4", 1), ("panda", 0), ("gen3", 2)])
def test_a_velocity_of_the_wrong_sign_is_seen_as_soon_as_its_joint_moves(robot, joint, monkeypatch):
    measure = Plant.measure

    def turned(plant):
        seen = measure(plant)
        return seen._replace(v=np.where(np.arange(seen.v.size) == joint, -1.0, 1.0) * seen.v)

    monkeypatch.setattr(Plant, "measure", turned)
    monkeypatch.setattr(steps, "compiled_steps", lambda *parts: None)  # which measure by themselves
    trace = run(Scenario(seed=5, robot={"name": robot}, start={"swivel": "random"}, duration_s=4.0, **QUICK))
    assert "do not follow their velocities" in trace.meta["ended"]
    moved = np.abs(trace.q_rad[:, joint] - trace.q_rad[0, joint])[trace.t_s <= trace.meta["stopped_at_s"]]
    assert moved.max() < 0.01


@pytest.mark.parametrize("seed", range(6))
def test_sound_runs_are_not_stopped(seed):
    """Wrong masses, friction from none to twice, delay, a payload, coarse and noise-free encoders: 225 more in docs."""
    rng = np.random.default_rng(900 + seed)
    plant = {
        "delay_ticks": int(rng.integers(0, 3)), "friction": float(rng.uniform(0.0, 2.0)), "mass_error": 0.2,
        "calibration_error_m": 0.001, "encoder_noise_rad": float(rng.choice([0.0, 3e-5])),
        "encoder_resolution_rad": float(rng.choice([0.0, 1e-4])),
        "velocity_cutoff_Hz": float(rng.choice([30.0, 100.0])),
    }  # fmt: skip
    trace = run(Scenario(
        seed=900 + seed, plant=plant, control={"preset": "tuned", "law": ("moc", "dcac")[seed % 2]},
        faults={"payload_kg": 0.5 * (seed % 3 == 0)}, start={"swivel": "random"}, **QUICK,
    ))  # fmt: skip
    assert trace.meta["ended"] == "completed"


@pytest.mark.parametrize(
    ("robot", "seed", "control", "delay"),
    [
        ("xarm7", 363081978, {"preset": "tuned"}, 0),
        ("xarm7", 1359370278, {"preset": "robust"}, 0),
        ("panda", 656269444, {}, 2),
    ],
)
def test_coarse_steps_without_noise_stop_nothing(robot, seed, control, delay):
    """While friction and a step of 0.5 mrad hold the joints, torque and momentum change: three that used to be stopped.

    Of 60 others 7 were stopped before, none is now.
    """
    plant = {"encoder_noise_rad": 0.0, "encoder_resolution_rad": 5e-4, "friction": 2.0, "delay_ticks": delay}
    trace = run(Scenario(
        seed=seed, robot={"name": robot}, control=control, start={"swivel": "random"}, plant=plant, duration_s=2.0,
        **QUICK,
    ))  # fmt: skip
    assert trace.meta["ended"] == "completed"


@pytest.mark.parametrize(("joint", "at"), [(None, 1.0), (1, 1.06), (3, 1.4)])
def test_frozen_coarse_encoders_are_found_all_the_same(joint, at):
    faults = {"frozen_at_s": at, "frozen_joint": joint, "frozen_velocity": "zero", "forged_stamps": True}
    plant = {"encoder_noise_rad": 0.0, "encoder_resolution_rad": 5e-4}
    trace = run(Scenario(seed=11, faults=faults, plant=plant, duration_s=3.0, **QUICK))
    assert 0.0 < stopped(trace, at) < 0.3
    assert max(excursion(trace)) < (0.006 if joint is None else 0.1)  # one joint: by its momentum alone
    assert force(trace).max() < 25.0
