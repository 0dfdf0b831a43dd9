"""The safety filter in whole runs: stops after faults, and no stops without faults."""

from unittest.mock import Mock

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.control import Controller
from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.errors import ControlError
from moc_opt.scenario import Scenario, run
from moc_opt.sim import Plant, PlantSettings
from moc_opt.sim.loop import simulate
from moc_opt.trace.trace import Trace

PERIOD, N, INF = 0.002, 7, float("inf")
QUICK = {"bound_samples": 0, "judge": False}
DCAC = {"law": "dcac"}
ANYWHERE = {"start": {"pose": "random"}}
SWIVEL = {"start": {"swivel": "random"}}
STILL = {"path": "line", "sizes": {"length": 0.0005}, "wait_s": 0.2, "hold_s": 10.0}
QUANTIZED = {"encoder_noise_rad": 0.0, "encoder_resolution_rad": 5e-4}


def stopped(at, within, error, newton, reason="", **scenario):
    """Check that a run stops at most `within` s after `at`, with bounds on tip error [m] and trocar force [N]."""
    trace = run(Scenario(**{"duration_s": 2.0, **scenario, **QUICK}))
    assert trace.meta["ended"].startswith("stopped: ")
    assert reason in trace.meta["ended"]
    ordered = trace.meta["stopped_at_s"]
    assert -PERIOD < ordered - at < within
    after = trace.t_s >= ordered
    coast = np.linalg.norm(trace.tip_m[after] - trace.tip_m[after][0], axis=1).max()
    assert max(trace.tip_error_registered_m[~after].max(initial=0.0), coast) < error
    assert np.linalg.norm(trace.trocar_force_N, axis=1).max() < newton
    return trace


AT_REST = {
    "control": {"preset": "tuned"}, "duration_s": 4.7, **ANYWHERE,
    "task": {"path": "line", "sizes": {"length": 0.02}, "wait_s": 0.2, "hold_s": 10.0},
    "faults": {"replay_at_s": 4.0, "replay_ticks": 80, "forged_stamps": True},
}  # fmt: skip
FORGED = {"frozen_velocity": "zero", "forged_stamps": True}

# name: scenario, start of the fault [s], bounds on delay [s], tip error [m] and force [N], text of the stop's reason
STOPPED = {
    "all-dropped": ({"faults": {"drop_share": 1.0}}, 0.0, 0.0101, 2.5e-3, 3.0, "3 ticks late"),
    "lost": ({"faults": {"nan_at_s": 0.4, "nan_ticks": 9999}}, 0.4, 0.0061, 5e-3, INF, "not believed"),
    "frozen": ({"faults": {"frozen_at_s": 0.9}, "control": DCAC}, 0.9, 0.0101, 2.5e-3, 3.0, "3 ticks late"),
    "growing-lag": ({"faults": {"lag_at_s": 1.0, "lag_growth": 0.3}}, 1.0, 0.034, 1.0, 3.0, ""),
    "replayed": ({"faults": {"replay_at_s": 1.0, "replay_ticks": 200}}, 1.0, 0.0101, 1.0, 3.0, ""),
    # At rest, only repeated noise shows that the readings are a recording.
    "a recording of the resting arm": ({**AT_REST, "seed": 8316}, 4.0, 0.08, 2e-3, 5.0, "are a recording"),
    "a recording without noise in the wrench": (
        {**AT_REST, "seed": 8307, "plant": {"force_noise_N": 0.0, "torque_noise_Nm": 0.0}}, 4.0, 0.08, 2e-3, 5.0,
        "are a recording"),
    "frozen-with-forged-stamps": (
        {"faults": {"frozen_at_s": 1.7, **FORGED}, "seed": 501, "duration_s": 2.4,
         "start": {"pose": "random", "swivel": "random"}}, 1.7, 0.1, 4e-3, 5.0, ""),
    "forged-lag-at-rest": (
        {"faults": {"lag_at_s": 0.0, "lag_growth": 0.3, "forged_stamps": True}, "seed": 2345, "control": DCAC,
         "task": STILL, "duration_s": 1.5, **ANYWHERE}, 0.0, 0.24, 4e-3, 5.0, ""),
    "forged-lag-in-motion": (
        {"faults": {"lag_at_s": 0.6, "lag_growth": 0.3, "forged_stamps": True}, "seed": 2345, "control": DCAC,
         "robot": {"name": "gen3"}, "duration_s": 1.5, **ANYWHERE}, 0.6, 0.14, 4e-3, 5.0, ""),
    "one-frozen-without-the-check-of-repeats": (
        {"faults": {"frozen_at_s": 0.8, "frozen_joint": 1, "frozen_velocity": "zero"}, "seed": 2100, "duration_s": 3.0,
         "guard": {"repeat_reading_ticks": 10**6}, **SWIVEL}, 0.8, 0.183, 0.045, 25.0, ""),
    "trocar-slips": ({"faults": {"slip_m": 0.1, "slip_at_s": 1.5}}, 1.5, 0.1, 1.0, 75.0, "force has been above 15 N"),
    "trocar-slips-while-the-wrench-is-frozen": (
        {"faults": {"frozen_at_s": 0.4, "frozen_wrench": True, "slip_m": 0.1, "slip_at_s": 0.8}, "seed": 2140},
        0.4, 0.056, 1.0, INF, "the wrench sensor repeats its reading"),
    "drift-of-positions-only": (
        {"faults": {"drift_rad_per_s": 0.05, "drift_at_s": 0.5, "drift_velocity": "apart"}, "seed": 2210, **SWIVEL},
        0.5, 0.1, 5e-3, 5.0, "do not follow their velocities"),
    "drift-of-positions-and-velocities": (
        {"faults": {"drift_at_s": 2.02, "drift_rad_per_s": 0.05}, "seed": 7033, "control": {"preset": "robust"},
         "task": {"v_max_m_per_s": 0.07730648346067734}, "duration_s": 6.0, **SWIVEL},
        2.02, 4.0, 0.13, 32.0, "the trocar's force"),
    "coarse-frozen": (
        {"faults": {"frozen_at_s": 1.0, **FORGED}, "seed": 11, "plant": QUANTIZED}, 1.0, 0.3, 0.006, 25.0, ""),
    "coarse-one-frozen": (
        {"faults": {"frozen_at_s": 1.4, "frozen_joint": 3, **FORGED}, "seed": 11, "plant": QUANTIZED},
        1.4, 0.3, 0.1, 25.0, ""),
    "one-frozen-without-noise": (
        {"faults": {"frozen_at_s": 1.2, "frozen_joint": 1, "frozen_velocity": "zero"}, "duration_s": 4.0,
         "plant": {"encoder_noise_rad": 0.0}},
        1.2, 1.5, 0.1, 32.0, ""),
}  # fmt: skip


@pytest.mark.parametrize("name", STOPPED)
def test_wrong_measurements_or_a_slipping_trocar_stop_the_arm(name):
    scenario, *limits = STOPPED[name]
    trace = stopped(*limits, **scenario)
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.03
    after = trace.t_s >= trace.meta["stopped_at_s"]
    if scenario.get("control") is not DCAC:
        assert set(trace.fault[after]) == {"stopped"}
        assert set(trace.status[after]) == {"none"}
        assert np.isnan(trace.x_rad_per_s[after]).all()
        assert not (trace.fault[~after] == "stopped").any()


# fault of the encoder, bound on the delay of the stop [s], bound on the tip error [m]
@pytest.mark.parametrize(("wrong", "within", "error"), [
    ({"frozen_velocity": "repeated"}, 0.0121, 0.012), ({"frozen_velocity": "zero"}, 0.0121, 0.012),
    ({"lag_growth": 0.05}, 0.21, 0.012), ({"lag_growth": 0.5}, 0.03, 0.012),
    ({"lag_ticks": 8, "lag_growth": 1e-6}, 0.03, 0.006), ({"lag_ticks": 40, "lag_growth": 1e-6}, 0.03, 0.006),
], ids=str)  # fmt: skip
@pytest.mark.parametrize("robot", ["lwr4", "panda", "xarm7", "lwr4_rail"])
def test_stuck_or_lagging_encoder_stops_the_arm(robot, wrong, within, error):
    rng = np.random.default_rng([2110, len(robot), round(1e4 * within)])
    kind = "frozen" if "frozen_velocity" in wrong else "lag"
    at, joint, seed = float(rng.uniform(0.3, 1.0)), int(rng.integers(7)), int(rng.integers(2000, 3000))
    stopped(at, within, error, 6.0, seed=seed, robot={"name": robot}, duration_s=at + within + 0.1, **ANYWHERE,
            faults={f"{kind}_at_s": at, f"{kind}_joint": joint, **wrong})  # fmt: skip


@pytest.mark.parametrize("gain", [-1.0, 0.0])
@pytest.mark.parametrize(("arm", "joint", "seed"), [
    ("lwr4", 4, 3), ("iiwa14", 4, 4), ("panda", 4, 3), ("gen3", 2, 0), ("xarm7", 2, 0), ("lwr4_rail", 3, 4),
])  # fmt: skip
def test_broken_drive_stops_the_arm(arm, joint, seed, gain, monkeypatch):
    sound = Plant.step

    def step(plant, tau, trocar=None):
        tau = np.array(tau)
        if plant.time >= 0.5 - 1e-9:
            tau[joint - 1] *= gain
        sound(plant, tau, trocar)

    monkeypatch.setattr(Plant, "step", step)
    trace = run(Scenario(robot={"name": arm}, seed=seed, duration_s=2.0, **ANYWHERE, **QUICK))
    assert trace.meta["ended"].startswith("stopped")
    after = trace.tip_m[trace.t_s >= 0.5]
    assert np.linalg.norm(after - after[0], axis=1).max() < 0.05


@pytest.mark.parametrize("gap", [
    {"nan_at_s": 0.4, "nan_ticks": 3}, {"frozen_at_s": 0.4, "frozen_ticks": 3},
    {"frozen_at_s": 0.4, "frozen_ticks": 3, "late_ticks": 2},
], ids=["nan", "frozen", "late-and-frozen"])  # fmt: skip
def test_short_gap_in_measurements_is_bridged(gap):
    kind = next(name for name in gap if name.endswith("_ticks"))
    late, robust = {"late_ticks": gap.get("late_ticks", 0)}, {"preset": "robust"}
    clean, bridged = (run(Scenario(control=robust, faults=f, duration_s=0.8, **QUICK)) for f in (late, gap))
    assert clean.meta["ended"] == bridged.meta["ended"] == "completed"
    assert np.abs(bridged.tip_m - clean.tip_m).max() < 2e-4
    stopped(0.4, 0.01 + 1e-9, 1.0, INF, control=robust, faults={**gap, kind: 4}, duration_s=0.8)


@pytest.mark.parametrize("control", [
    {"preset": "tuned", "limit_margin_rad": 0.0}, {**DCAC, "K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0},
], ids=["moc", "dcac"])  # fmt: skip
def test_arm_that_meets_a_wall_is_stopped(control):
    """The circle leads joint 4 into its virtual wall."""
    wall = {"position_margin_rad": 0.62}
    blind = {**wall, "rcm_error_m": None, "trocar_force_N": None, "motion": False}
    free = run(Scenario(control=control, guard=blind, **QUICK))
    assert free.meta["ended"] == "completed"
    assert free.rcm_error_m.max() > 0.014
    assert {w["of"] for w in free.meta["warnings"]} == {"the RCM error", "the trocar's force"}
    reason = "the RCM error has been above 10 mm"
    trace = stopped(0.0, 20.0, 0.03, 11.0, reason, control=control, guard=wall, duration_s=None)
    assert trace.rcm_error_m.max() < 0.0145
    # the tissue pushes the arm back until the brakes close
    assert np.linalg.norm(trace.trocar_force_N[-1]) < 0.5 * SafetyFilterSettings().stop_yield_N + 0.5
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.03
    assert 0.0 < trace.meta["warnings"][0]["first_s"] < trace.meta["stopped_at_s"]


def unknown_plant(seed):
    rng = np.random.default_rng(900 + seed)
    plant = {
        "delay_ticks": int(rng.integers(0, 3)), "friction": float(rng.uniform(0.0, 2.0)), "mass_error": 0.2,
        "calibration_error_m": 0.001, "encoder_noise_rad": float(rng.choice([0.0, 3e-5])),
        "encoder_resolution_rad": float(rng.choice([0.0, 1e-4])),
        "velocity_cutoff_Hz": float(rng.choice([30.0, 100.0])),
    }  # fmt: skip
    return {
        "seed": 900 + seed, "plant": plant, "control": {"preset": "tuned", "law": ("moc", "dcac")[seed % 2]},
        "faults": {"payload_kg": 0.5 * (seed % 3 == 0)}, **SWIVEL,
    }  # fmt: skip


def coarse(robot, seed, control, delay):
    """High friction and coarse encoders keep readings constant, as a fault would."""
    plant = {**QUANTIZED, "friction": 2.0, "delay_ticks": delay}
    return {"seed": seed, "robot": {"name": robot}, "control": control, "plant": plant, "duration_s": 2.0, **SWIVEL}


@pytest.mark.parametrize("scenario", [
    *map(unknown_plant, range(4)),
    *({"control": {"preset": "robust", "law": law}, "faults": {"late_ticks": ticks}, "plant": {"delay_ticks": 0}}
      for ticks, law in ((1, "moc"), (2, "dcac"), (3, "moc"))),
    coarse("xarm7", 363081978, {"preset": "tuned"}, 0), coarse("xarm7", 1359370278, {"preset": "robust"}, 0),
    coarse("panda", 656269444, {}, 2),
], ids=lambda s: "-".join(map(str, (s.get("seed", "late"), s["control"].get("law", "")))))  # fmt: skip
def test_harmless_plant_deviations_do_not_stop_the_arm(scenario):
    assert run(Scenario(**{"duration_s": 3.0, **scenario, **QUICK})).meta["ended"] == "completed"


@pytest.mark.parametrize("preset", ["default", "tuned", "robust", "paper"])
@pytest.mark.parametrize("law", ["moc", "dcac"])
def test_runs_without_faults_are_not_stopped(preset, law):
    """Only the paper's parameters give warnings."""
    control = {"law": law} if preset == "default" else {"law": law, "preset": preset}
    seed = len(preset + law) % 4
    task = {"path": ("circle", "sinusoid", "spiral", "line")[seed]}
    trace = run(Scenario(control=control, seed=seed, task=task, **SWIVEL, **QUICK))
    assert not trace.meta["ended"].startswith("stopped")
    if preset != "paper":
        assert "warnings" not in trace.meta
        assert not trace.limited.any()


@pytest.mark.parametrize("plant", [{}, {"friction": 0.0}, {"trocar_stiffness_N_per_m": 3000.0}], ids=str)
def test_robust_gains_stay_stable_with_a_delay_of_four_ticks(plant):
    base = Scenario(control={"preset": "robust"}, seed=3, duration_s=2.0, **SWIVEL, **QUICK)
    one, four = (run(base.change(plant={"delay_ticks": ticks, **plant})) for ticks in (1, 4))
    assert four.meta["ended"] == "completed"
    assert not four.limited.any()
    assert four.tip_error_model_m.mean() < 3e-4
    rates = [np.diff(trace.tau_Nm[500:], axis=0).std() for trace in (one, four)]
    assert rates[1] < 1.5 * rates[0]


@pytest.mark.parametrize(("every", "seed"), [(1, 0), (100, 1), (10_000, 2)])
def test_hostile_controller_moves_no_joint_past_its_limit(robot, every, seed):
    """The torque is twice the limit, in directions that change at random."""
    # The encoder bias is zero here. With 0.1 mrad, a joint would pass its limit in three of 60 runs.
    free = PlantSettings(trocar_stiffness_N_per_m=0.0, trocar_damping_Ns_per_m=0.0, encoder_bias_rad=0.0)
    plant = Plant(robot.data, free, seed=seed)
    place = 0.1 + 0.8 * np.random.default_rng(seed).uniform(size=N)
    plant.reset(robot.q_min + place * (robot.q_max - robot.q_min))
    asked = np.random.default_rng(seed).choice([-1.0, 1.0], (601, N))[np.arange(1, 601) // every]
    saboteur = Mock(spec=["start", "tick", "set_applied_torque", "columns", "note"])
    saboteur.tick.side_effect, saboteur.columns.return_value = iter(2.0 * robot.tau_max * asked), {}
    guard = SafetyFilter(robot, SafetyFilterSettings(), PERIOD, incision=False, momentum=False)
    trace = simulate(plant, saboteur, *map(np.zeros, ((600, 3, 3), (600, 2, 3), (600, 2, 3))), safety_filter=guard)
    assert trace.limited.any()
    assert (trace.q_rad >= robot.q_min - 1e-3).all()
    assert (trace.q_rad <= robot.q_max + 1e-3).all()
    assert (np.abs(trace.tau_Nm) <= robot.tau_max).all()
    rate = np.abs(np.diff(trace.tau_Nm, axis=0)).max() / PERIOD
    assert rate <= SafetyFilterSettings().torque_rate_Nm_per_s * (1 + 1e-9)
    # A joint may exceed its speed limit for some ticks.
    speed = np.abs(trace.v_rad_per_s) / robot.v_max
    assert speed.max() < 5.0
    assert np.median(speed.max(axis=1)) < 2.0


@pytest.mark.parametrize(("how", "reason"), [
    (ControlError("no idea"), "no idea"), (ZeroDivisionError("no idea"), "no idea"),
    (float("nan"), "torque is not finite"), (INF, "torque is not finite"),
])  # fmt: skip
def test_arm_is_stopped_if_the_controller_breaks_down(how, reason, monkeypatch):
    sound, calls = Controller.tick, iter(range(1000))

    def tick(controller, *given):
        if next(calls) <= 100:  # the first call only initializes libraries
            return sound(controller, *given)
        if isinstance(how, Exception):
            raise how
        return np.full(N, how)

    monkeypatch.setattr(Controller, "tick", tick)
    trace = stopped(0.2, 1e-9, 2e-3, 3.0, reason)
    assert trace.t_s[-1] - trace.meta["stopped_at_s"] == pytest.approx(0.5, abs=0.01)
    assert np.isfinite(trace.tau_Nm).all()
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.02


def test_command_line_reports_that_an_arm_ran_away(tmp_path, capsys):
    file, out = tmp_path / "s.toml", tmp_path / "t.parquet"
    stiff = "plant = {trocar_stiffness_N_per_m = 1e6, trocar_damping_Ns_per_m = 1e4}\n"
    file.write_text(f"duration_s = 1.2\nbound_samples = 0\njudge = false\n{stiff}", encoding="utf-8")
    assert main(["run", str(file), "--trace", str(out)]) == 3  # not 2, because the input is valid
    assert "s: ran away" in capsys.readouterr().err, "the message begins with the file's name, s"
    assert Trace.load(out).meta["ended"].startswith("ran away")
