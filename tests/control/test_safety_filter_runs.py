"""The guard in whole runs: what it stops, how soon and at which cost; what it must leave alone."""

import json

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.errors import ControlError, PlantError
from moc_opt.scenario import ControllerAdapter, Scenario, Setup, run
from moc_opt.sim import Plant, PlantSettings
from moc_opt.sim.loop import simulate
from moc_opt.sim.plant import Stop
from moc_opt.sim.record import RunAway
from moc_opt.trace.trace import Trace
from tests.control.test_incision import seen

PERIOD, N = 0.002, 7
QUICK = {"bound_samples": 0, "judge": False}
LAWS = {"moc": {"preset": "tuned"}, "dcac": {"law": "dcac"}}
ANYWHERE = {"start": {"pose": "random"}}
SWIVEL = {"start": {"swivel": "random"}}
STILL = {"path": "line", "sizes": {"length": 0.0005}, "wait_s": 0.2, "hold_s": 10.0}
QUANTIZED = {"encoder_noise_rad": 0.0, "encoder_resolution_rad": 5e-4}


def delay(trace, at_s=0.0):
    """How long after its cause the stop was ordered [s]."""
    assert trace.meta["ended"].startswith("stopped: "), trace.meta["ended"]
    return trace.meta["stopped_at_s"] - at_s


def excursion(trace):
    """Largest tip error up to the stop, or way of the tip after it [m]."""
    stop = trace.t_s >= trace.meta["stopped_at_s"]
    coast = np.linalg.norm(trace.tip_m[stop] - trace.tip_m[stop][0], axis=1).max()
    return max(trace.tip_error_registered_m[~stop].max(initial=0.0), coast)


def force(trace):
    return np.linalg.norm(trace.trocar_force_N, axis=1).max()


# --- measurements that are late, frozen, repeated, replayed or adrift ---

# name: the run, when the fault begins [s], by when it is stopped [s after], tip error [m], force [N], the reason
STOPPED = {
    "all-dropped": ({"faults": {"drop_share": 1.0}}, 0.0, 0.0101, 2.5e-3, 3.0, "3 ticks late"),
    "frozen": ({"faults": {"frozen_at_s": 0.9}, "control": LAWS["dcac"]}, 0.9, 0.0101, 2.5e-3, 3.0, "3 ticks late"),
    "frozen-small-circle": (
        {"faults": {"frozen_at_s": 0.9}, "task": {"path": "circle", "sizes": {"radius": 0.003}}},
        0.9, 0.0101, 2.5e-3, 3.0, "3 ticks late",
    ),
    "growing-lag": ({"faults": {"lag_at_s": 1.0, "lag_growth": 0.05}}, 1.0, 0.2, 1.0, 3.0, ""),
    "fast-growing-lag": ({"faults": {"lag_at_s": 1.0, "lag_growth": 0.3}}, 1.0, 0.034, 1.0, 3.0, ""),
    "replayed": ({"faults": {"replay_at_s": 1.0, "replay_ticks": 200}}, 1.0, 0.0101, 1.0, 3.0, ""),
    "slip-under-a-frozen-wrench": (
        {"faults": {"frozen_at_s": 0.4, "frozen_wrench": True, "slip_m": 0.1, "slip_at_s": 0.8}, "seed": 2140},
        0.4, 0.056, 1.0, np.inf, "the wrench sensor repeats its reading",
    ),
    "drift-apart-from-the-velocity": (
        {"faults": {"drift_rad_per_s": 0.05, "drift_at_s": 0.5, "drift_velocity": "apart"}, "seed": 2210, **SWIVEL},
        0.5, 0.1, 5e-3, 5.0, "do not follow their velocities",
    ),
    "drift-with-the-velocity": (  # the model agrees with drifting encoders: the force is the only sign
        {"faults": {"drift_rad_per_s": 0.05, "drift_at_s": 0.5}, "seed": 2200, "duration_s": 6.0, **SWIVEL},
        0.5, 5.5, 0.13, 32.0, "the trocar's force",
    ),
    "coarse-frozen": (
        {"faults": {"frozen_at_s": 1.0, "frozen_velocity": "zero", "forged_stamps": True}, "seed": 11,
         "plant": QUANTIZED, "duration_s": 3.0}, 1.0, 0.3, 0.006, 25.0, "",
    ),
    "coarse-one-frozen": (  # found by its momentum alone
        {"faults": {"frozen_at_s": 1.4, "frozen_velocity": "zero", "forged_stamps": True, "frozen_joint": 3},
         "seed": 11, "plant": QUANTIZED, "duration_s": 3.0}, 1.4, 0.3, 0.1, 25.0, "",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", STOPPED)
def test_measurements_that_are_not_to_be_believed_stop_the_arm(name):
    scenario, at, within, error, newton, reason = STOPPED[name]
    trace = run(Scenario(**{"duration_s": 2.0, **scenario, **QUICK}))
    assert 0.0 <= delay(trace, at) < within
    assert reason in trace.meta["ended"]
    assert excursion(trace) < error
    assert force(trace) < newton
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.03


@pytest.mark.parametrize(("seed", "noise"), [(8316, True), (8307, False), (8310, True)])
def test_a_recording_of_the_resting_arm_is_seen_through(seed, noise):
    """It agrees with its own velocities and with the model; that its noise came before is the only sign."""
    trace = run(Scenario(
        seed=seed, control=LAWS["moc"], duration_s=4.7, **ANYWHERE, **QUICK,
        task={"path": "line", "sizes": {"length": 0.02}, "wait_s": 0.2, "hold_s": 10.0},
        faults={"replay_at_s": 4.0, "replay_ticks": 80, "forged_stamps": True},
        plant={} if noise else {"force_noise_N": 0.0, "torque_noise_Nm": 0.0},
    ))  # fmt: skip
    assert delay(trace, 4.0) < 0.08
    assert trace.meta["ended"].startswith(("stopped: the measurements are a recording", "stopped: one encoder lags"))
    assert excursion(trace) < 2e-3
    assert force(trace) < 5.0


@pytest.mark.parametrize("seed", range(3))
def test_frozen_readings_with_forged_numbers_are_seen_through(seed):
    """Poses and moments that no level was chosen on; small tasks and large ones."""
    rng = np.random.default_rng(100 + seed)
    at = float(rng.uniform(0.0, 2.5))
    task = {"path": str(rng.choice(["line", "spiral"])), "v_max_m_per_s": float(rng.uniform(0.01, 0.1))}
    faults = {"frozen_at_s": at, "forged_stamps": True, "frozen_velocity": ("repeated", "zero")[seed % 2]}
    start = {"pose": "random", "swivel": "random"}
    trace = run(Scenario(seed=500 + seed, start=start, faults=faults, task=task, duration_s=at + 0.7, **QUICK))
    assert delay(trace, at) < 0.1
    assert excursion(trace) < 4e-3
    assert force(trace) < 5.0


def one_encoder(kind, rng, joint):
    """A fault of one joint's encoder, when it begins [s], by when it is found [s after], and the error until then [m].

    What happens without the check, in order: 31 mm and 24 N; 53 mm; 48 mm and 17 N.
    """
    if kind == "stuck":  # a filtered velocity dies out while the position stays
        at = float(rng.uniform(0.3, 1.5))
        velocity = ("repeated", "zero")[joint % 2]
        return {"frozen_at_s": at, "frozen_velocity": velocity, "frozen_joint": joint}, at, 0.0121, 0.012
    if kind == "lag":  # a reading comes twice now and then
        at, growth = float(rng.uniform(0.3, 1.0)), float(rng.uniform(0.05, 0.5))
        return {"lag_at_s": at, "lag_growth": growth, "lag_joint": joint}, at, 0.01 / growth + 0.01, 0.012
    at, ticks = float(rng.uniform(0.3, 1.0)), int(rng.integers(8, 41))  # from one tick to the next
    return {"lag_at_s": at, "lag_ticks": ticks, "lag_growth": 1e-6, "lag_joint": joint}, at, 0.03, 0.004


@pytest.mark.parametrize("kind", ["stuck", "lag", "old"])
@pytest.mark.parametrize("robot", ["lwr4", "panda", "xarm7", "lwr4_rail"])
def test_one_encoder_that_is_stuck_or_lags_is_found(robot, kind):
    rng = np.random.default_rng([2110, len(robot), len(kind)])
    for joint in rng.permutation(7)[:3]:
        faults, at, within, error = one_encoder(kind, rng, int(joint))
        seed = int(rng.integers(2000, 3000))
        trace = run(Scenario(
            seed=seed, robot={"name": robot}, faults=faults, duration_s=at + within + 0.1, **ANYWHERE, **QUICK
        ))  # fmt: skip
        assert delay(trace, at) < within
        assert excursion(trace) < error
        assert force(trace) < 6.0


@pytest.mark.parametrize(("robot", "task"), [("lwr4", STILL), ("gen3", {}), ("xarm7", STILL)])
def test_a_lag_under_forged_numbers_repeats_readings(robot, task):
    """It grows by a reading that comes twice, at rest as in motion, from the first tick on: 57 mm without."""
    rng = np.random.default_rng(2120)
    for at in (0.0, float(rng.uniform(0.3, 1.0))):
        growth = float(rng.uniform(0.05, 1.0))
        trace = run(Scenario(
            seed=int(rng.integers(2000, 3000)), robot={"name": robot}, control=LAWS["dcac"], task=task, duration_s=1.5,
            faults={"lag_at_s": at, "lag_growth": growth, "forged_stamps": True}, **ANYWHERE, **QUICK,
        ))  # fmt: skip
        # Before the arm moves no velocity is other than zero, and no lag does harm.
        assert delay(trace, max(at, 0.1)) < 5 / growth * PERIOD + 0.1
        assert force(trace) < 5.0
        assert excursion(trace) < 4e-3


@pytest.mark.parametrize(("seed", "joint"), [(2100, 1), (2101, 3), (2100, 6)])
def test_one_stuck_encoder_is_found_by_its_noise_at_the_latest(joint, seed):
    """After as many ticks as its noise lets it repeat itself: before that check 204 mm and 61 N."""
    at = float(np.random.default_rng([seed, joint]).uniform(0.5, 2.0))
    faults = {"frozen_at_s": at, "frozen_joint": joint, "frozen_velocity": "zero"}
    guard = {"repeat_reading_ticks": 10**6}
    scenario = Scenario(seed=seed, faults=faults, duration_s=3.0, guard=guard, **SWIVEL, **QUICK)
    trace = run(scenario)
    assert delay(trace, at) <= PERIOD * (scenario.told_guard.repeat_joint_ticks + 2)
    assert force(trace) < 25.0
    assert excursion(trace) < 0.045


def test_a_stuck_encoder_without_noise_is_found_by_its_momentum_or_felt():
    """At the latest the trocar's force stops it: not before tens of millimetres."""
    faults = {"frozen_at_s": 1.2, "frozen_joint": 1, "frozen_velocity": "zero"}
    scenario = Scenario(faults=faults, plant={"encoder_noise_rad": 0.0}, duration_s=4.0, **QUICK)
    blind = run(scenario.change(guard={"motion": False, "trocar_force_N": None, "rcm_error_m": None}))
    trace = run(scenario)
    assert delay(trace, 1.2) < 1.5
    assert force(trace) < 32.0
    assert excursion(trace) < min(0.1, 0.8 * blind.tip_error_registered_m.max())


def test_a_drift_that_draws_the_tip_out_of_the_incision_is_felt_by_the_whole_force():
    """At the believed depth its force passes for a touch of the tip: 223 mm and 85 N, to the end of the run."""
    scenario = Scenario(
        seed=7033, control={"preset": "robust"}, task={"v_max_m_per_s": 0.07730648346067734}, duration_s=6.0,
        faults={"drift_at_s": 2.02, "drift_rad_per_s": 0.05}, **SWIVEL, **QUICK,
    )  # fmt: skip
    trace = run(scenario)
    assert "the trocar's force" in trace.meta["ended"]
    assert force(trace) < 32.0
    assert excursion(trace) < 0.13


@pytest.mark.parametrize(("robot", "joint"), [("lwr4", 1), ("gen3", 2)])
def test_a_velocity_of_the_wrong_sign_is_seen_as_soon_as_its_joint_moves(robot, joint, monkeypatch):
    measure = Plant.measure

    def turned(plant):
        seen = measure(plant)
        return seen._replace(v=np.where(np.arange(seen.v.size) == joint, -1.0, 1.0) * seen.v)

    monkeypatch.setattr(Plant, "measure", turned)
    trace = run(Scenario(seed=5, robot={"name": robot}, duration_s=4.0, **SWIVEL, **QUICK))
    assert "do not follow their velocities" in trace.meta["ended"]
    moved = np.abs(trace.q_rad[:, joint] - trace.q_rad[0, joint])[trace.t_s <= trace.meta["stopped_at_s"]]
    assert moved.max() < 0.01


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "faults", [{"nan_at_s": 0.8, "nan_ticks": 9999}, {"jump_at_s": 0.8, "jump_rad": 0.2}], ids=["nan", "jump"]
)
def test_sensors_that_are_lost_stop_the_arm(law, faults):
    scenario = Scenario(control=LAWS[law], faults=faults, **QUICK)
    trace = run(scenario)
    assert trace.meta["ended"].startswith("stopped: measurements not believed")
    patience = 1e-9 + 0.8 + PERIOD * scenario.guard.patience_ticks
    assert trace.meta["stopped_at_s"] == pytest.approx(patience)
    assert trace.t_s[-1] == pytest.approx(patience + scenario.guard.stop_s)
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.02
    assert excursion(trace) < 0.005
    if law == "moc":
        after = trace.t_s >= trace.meta["stopped_at_s"]
        assert set(trace.fault[after]) == {"stopped"}
        assert set(trace.status[after]) == {"none"}
        assert np.isnan(trace.x_rad_per_s[after]).all()
        assert not (trace.fault[~after] == "stopped").any()


@pytest.mark.parametrize(
    ("gap", "longer"),
    [({"nan_at_s": 0.8, "nan_ticks": 3}, {"nan_at_s": 0.8, "nan_ticks": 4}),
     ({"frozen_at_s": 0.8, "frozen_ticks": 3}, {"frozen_at_s": 0.8, "frozen_ticks": 4}),
     ({"frozen_at_s": 0.8, "frozen_ticks": 3, "late_ticks": 2},
      {"frozen_at_s": 0.8, "frozen_ticks": 4, "late_ticks": 2})],
    ids=["nan", "frozen", "late-and-frozen"],
)  # fmt: skip
def test_a_short_gap_is_bridged(gap, longer):
    late = {"late_ticks": gap.get("late_ticks", 0)}
    clean, bridged, lost = (
        run(Scenario(control={"preset": "robust"}, faults=f, duration_s=1.2, **QUICK)) for f in (late, gap, longer)
    )
    assert clean.meta["ended"] == bridged.meta["ended"] == "completed"
    assert np.abs(bridged.tip_m - clean.tip_m).max() < 2e-4
    assert delay(lost, 0.8) <= 0.01


# --- the incision ---

# The wall begins so far inside the limits that the circle leads joint 4 into it.
WALL = {"position_margin_rad": 0.62}
AT_WALL = {
    "moc": {"preset": "tuned", "limit_margin_rad": 0.0},
    "dcac": {"law": "dcac", "K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0},
}  # fmt: skip
BLIND = {"rcm_error_m": None, "trocar_force_N": None, "motion": False}


def test_the_force_agrees_with_the_plant(robot):
    """In a run with wrong masses and noise: within half a newton of the truth, once means are taken."""
    trace = run(Scenario(control={"preset": "tuned"}, faults={"slip_m": 0.01}, duration_s=3.0, **QUICK))
    wrenches = np.hstack([trace.force_N, trace.torque_Nm])
    felt = np.array([
        seen(robot, q, p, w)[1]
        for q, p, w in zip(trace.q_rad, trace.trocar_registered_m, wrenches, strict=True)
    ])  # fmt: skip
    true = np.linalg.norm(trace.trocar_force_N, axis=1)
    assert true.max() > 7.0
    for part in (slice(250, 950), slice(1150, None)):  # before and after the slip
        assert np.sqrt(np.mean(felt[part] ** 2)) == pytest.approx(np.sqrt(np.mean(true[part] ** 2)), abs=0.5)


@pytest.mark.parametrize("control", AT_WALL.values(), ids=AT_WALL)
def test_an_arm_at_its_wall_is_stopped(control):
    """Without the limit on the RCM error it goes on to the end, 14 mm and 11 N off and more: the tip is fine."""
    blind = run(Scenario(control=control, guard={**WALL, **BLIND}, **QUICK))
    assert blind.meta["ended"] == "completed"
    assert blind.rcm_error_m.max() > 0.014
    assert {w["of"] for w in blind.meta["warnings"]} == {"the RCM error", "the trocar's force"}
    trace = run(Scenario(control=control, guard=WALL, **QUICK))
    assert trace.meta["ended"].startswith("stopped: the RCM error has been above 10 mm")
    stop = trace.t_s >= trace.meta["stopped_at_s"]
    assert trace.rcm_error_m.max() < 0.0145
    # the tissue's spring pushes the arm back, its brakes open, until they close at half of stop_yield_N
    newton = np.linalg.norm(trace.trocar_force_N[stop], axis=1)
    assert newton.max() < 11.0
    assert newton[-1] < 0.5 * SafetyFilterSettings().stop_yield_N + 0.5
    assert excursion(trace) < 0.03
    assert np.abs(trace.v_rad_per_s[stop]).max() < 0.3
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.03
    rcm, *_ = trace.meta["warnings"]
    assert rcm["of"] == "the RCM error"
    assert 0.0 < rcm["first_s"] < trace.meta["stopped_at_s"]


def test_a_trocar_that_tears_away_is_felt():
    """The registered trocar stays where it was, so only the force can tell: 75 N otherwise."""
    trace = run(Scenario(faults={"slip_m": 0.1, "slip_at_s": 1.5}, **QUICK))
    assert trace.meta["ended"].startswith("stopped: the trocar's force has been above 15 N")
    assert delay(trace, 1.5) < 0.1


# --- what is left alone ---


@pytest.mark.parametrize("preset", ["default", "tuned", "robust", "paper"])
@pytest.mark.parametrize("law", ["moc", "dcac"])
def test_sound_runs_are_not_stopped(preset, law):
    """Nor warned of, but for the paper's parameters, whose runs are up to 9 mm off."""
    control = {"law": law} if preset == "default" else {"law": law, "preset": preset}
    seed = len(preset + law) % 4
    task = {"path": ("circle", "sinusoid", "spiral", "line")[seed]}
    trace = run(Scenario(control=control, seed=seed, task=task, **SWIVEL, **QUICK))
    assert not trace.meta["ended"].startswith("stopped")
    if preset != "paper":
        assert "warnings" not in trace.meta
        assert not trace.limited.any()


@pytest.mark.parametrize("seed", range(4))
def test_no_sound_plant_is_stopped(seed):
    """Wrong masses, friction from none to twice, a constant delay, a payload, coarse and noise-free encoders."""
    rng = np.random.default_rng(900 + seed)
    plant = {
        "delay_ticks": int(rng.integers(0, 3)), "friction": float(rng.uniform(0.0, 2.0)), "mass_error": 0.2,
        "calibration_error_m": 0.001, "encoder_noise_rad": float(rng.choice([0.0, 3e-5])),
        "encoder_resolution_rad": float(rng.choice([0.0, 1e-4])),
        "velocity_cutoff_Hz": float(rng.choice([30.0, 100.0])),
    }  # fmt: skip
    trace = run(Scenario(
        seed=900 + seed, plant=plant, control={"preset": "tuned", "law": ("moc", "dcac")[seed % 2]},
        faults={"payload_kg": 0.5 * (seed % 3 == 0)}, duration_s=3.0, **SWIVEL, **QUICK,
    ))  # fmt: skip
    assert trace.meta["ended"] == "completed"


@pytest.mark.parametrize(("late", "law"), [(1, "moc"), (2, "dcac"), (3, "moc")])
def test_a_constant_delay_stops_nothing(late, law):
    control = {"preset": "robust", "law": law}
    trace = run(Scenario(control=control, faults={"late_ticks": late}, plant={"delay_ticks": 0}, **QUICK))
    assert trace.meta["ended"] == "completed"


@pytest.mark.parametrize(
    ("robot", "seed", "control", "delay_ticks"),
    [
        ("xarm7", 363081978, {"preset": "tuned"}, 0),
        ("xarm7", 1359370278, {"preset": "robust"}, 0),
        ("panda", 656269444, {}, 2),
    ],
)
def test_coarse_steps_without_noise_stop_nothing(robot, seed, control, delay_ticks):
    """While friction and a step of 0.5 mrad hold the joints, torque and momentum change: once a reason to stop."""
    plant = {**QUANTIZED, "friction": 2.0, "delay_ticks": delay_ticks}
    trace = run(Scenario(
        seed=seed, robot={"name": robot}, control=control, plant=plant, duration_s=2.0, **SWIVEL, **QUICK
    ))  # fmt: skip
    assert trace.meta["ended"] == "completed"


@pytest.mark.parametrize("plant", [{}, {"friction": 0.0}, {"trocar_stiffness_N_per_m": 3000.0}], ids=str)
def test_the_robust_gains_bear_four_ticks_of_delay(plant):
    """Also without friction to help, and against a stiff trocar: no joint begins to shake."""
    base = Scenario(control={"preset": "robust"}, seed=3, duration_s=2.5, **SWIVEL, **QUICK)
    one, four = (run(base.change(plant={"delay_ticks": ticks, **plant})) for ticks in (1, 4))
    assert four.meta["ended"] == "completed"
    assert not four.limited.any()
    assert four.tip_error_model_m.mean() < 3e-4
    rates = [np.diff(trace.tau_Nm[500:], axis=0).std() for trace in (one, four)]
    assert rates[1] < 1.5 * rates[0]


@pytest.mark.parametrize(("swivel", "law"), [(0.0, "moc"), (1.0, "dcac")])
def test_a_joint_that_begins_inside_its_wall_is_not_thrown_out_of_it(swivel, law):
    """At either end of the self-motion one joint stands on its limit; the wall used to throw the tip 25 mm off."""
    trace = run(Scenario(start={"swivel": swivel}, control={"law": law}, duration_s=1.5, **QUICK))
    assert trace.meta["ended"] == "completed"
    assert trace.tip_error_m.max() < 2e-3
    assert trace.rcm_error_m.max() < 4e-3


# --- controllers that break down ---


class Saboteur:
    """Asks for twice the largest torques, in directions that change at random; it sees no tip."""

    def __init__(self, robot, every, seed):
        self.robot, self.every, self.k = robot, every, 0
        self.rng = np.random.default_rng(seed)
        self.direction = self.rng.choice([-1.0, 1.0], N)

    def start(self, *_):
        pass

    def set_applied_torque(self, tau):
        pass

    def columns(self, ticks):
        return {}

    def note(self, row, columns):
        pass

    def tick(self, q, v, *_):
        self.k += 1
        if self.k % self.every == 0:
            self.direction = self.rng.choice([-1.0, 1.0], N)
        return 2.0 * self.robot.tau_max * self.direction


@pytest.mark.parametrize(("every", "seed"), [(1, 0), (100, 1), (10_000, 2)])
def test_a_saboteur_gets_no_joint_past_its_limit(robot, every, seed):
    # Readings without bias: of 60 such courses one passes a limit by 0.01 rad, with a bias of 0.1 mrad three do.
    free = PlantSettings.realistic(trocar_stiffness_N_per_m=0.0, trocar_damping_Ns_per_m=0.0, encoder_bias_rad=0.0)
    plant = Plant(robot.data, free, seed=seed)
    place = 0.1 + 0.8 * np.random.default_rng(seed).uniform(size=N)
    plant.reset(robot.q_min + place * (robot.q_max - robot.q_min))
    ticks = 600
    guard = SafetyFilter(robot, SafetyFilterSettings(), PERIOD, incision=False, momentum=False)
    trace = simulate(
        plant, Saboteur(robot, every, seed), np.zeros((ticks, 3, 3)), np.zeros((ticks, 2, 3)),
        np.zeros((ticks, 2, 3)), safety_filter=guard,
    )  # fmt: skip
    assert trace.limited.any()
    assert (trace.q_rad >= robot.q_min - 1e-3).all()
    assert (trace.q_rad <= robot.q_max + 1e-3).all()
    assert (np.abs(trace.tau_Nm) <= robot.tau_max).all()
    rate = np.abs(np.diff(trace.tau_Nm, axis=0)).max() / PERIOD
    assert rate <= SafetyFilterSettings().torque_rate_Nm_per_s * (1 + 1e-9)
    # speeds are braked, not foreseen: full torque the wrong way exceeds them for some ticks
    speed = np.abs(trace.v_rad_per_s) / robot.v_max
    assert speed.max() < 5.0
    assert np.median(speed.max(axis=1)) < 2.0


class Breaking(ControllerAdapter):
    """A controller that breaks down at a tick, in one way or another."""

    def __init__(self, controller, how):
        super().__init__(controller)
        self.how, self.k = how, 0

    def tick(self, *args):
        self.k += 1
        if self.k > 100:
            if isinstance(self.how, Exception):
                raise self.how
            return np.full(N, self.how)
        return super().tick(*args)


def broken_run(how, **options):
    setup = Setup(Scenario(control={"preset": "tuned"}, **QUICK))
    t = PERIOD * np.arange(400)
    paths = [np.stack(r.at(t), axis=1) for r in (setup.reference, setup.trocar, setup.registered)]
    return simulate(setup.plant, Breaking(setup.controller(), how), *paths, **options)


@pytest.mark.parametrize("how", [ControlError("no idea"), ZeroDivisionError("no idea"), float("nan"), float("inf")])
def test_a_controller_that_breaks_down_stops_the_arm(robot, how):
    guard = SafetyFilter(robot, SafetyFilterSettings(), PERIOD, incision=False, momentum=False)
    trace = broken_run(how, safety_filter=guard, stop=Stop(40.0, 0.3))
    assert trace.meta["ended"].startswith("stopped: ")
    assert ("no idea" if isinstance(how, Exception) else "torque is not finite") in trace.meta["ended"]
    assert len(trace) == 100 + 150 + 1
    assert np.isfinite(trace.tau_Nm).all()
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.02


def test_a_run_away_keeps_its_trace():
    """Without a guard, a torque that is no number ends the run in the plant; the rows so far are kept."""
    with pytest.raises(RunAway, match="ran away") as found:
        broken_run(float("nan"))
    assert isinstance(found.value, PlantError)
    assert len(found.value.trace) == 101
    assert found.value.trace.meta["ended"].startswith("ran away")
    assert np.isfinite(found.value.trace.q_rad).all()


@pytest.mark.parametrize(
    ("ended", "rest"),
    [
        ("stopped: measurements not believed", 'control.law = "dcac"\nfaults = {nan_at_s = 0.1, nan_ticks = 9999}\n'),
        ("ran away", "plant = {trocar_stiffness_N_per_m = 1e6, trocar_damping_Ns_per_m = 1e4}\n"),
    ],
)
def test_the_command_line_says_how_a_run_ended_and_keeps_its_trace(tmp_path, capsys, ended, rest):
    file, out = tmp_path / "s.toml", tmp_path / "t.parquet"
    file.write_text(f"duration_s = 1.2\nbound_samples = 0\njudge = false\n{rest}", encoding="utf-8")
    assert main(["run", str(file), "--trace", str(out)]) == 3  # the input is as it should be: the arm is not
    assert f"s: {ended}" in capsys.readouterr().err, "a run without a name has its file's"
    assert Trace.load(out).meta["ended"].startswith(ended)
    assert main(["run", str(file), "--json"]) == 3
    said = capsys.readouterr().out
    if ended.startswith("stopped"):
        found = json.loads(said)
        assert found["ended"].startswith(ended)
        assert found["completed"] == 0.0
        assert found["share_of_run"] == pytest.approx(len(Trace.load(out)) / 600)
