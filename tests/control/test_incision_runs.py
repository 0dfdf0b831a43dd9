"""The guard's knowledge of the incision in whole runs: against the plant's truth, at a wall, with a torn trocar."""


import numpy as np
import pytest

from moc_opt.control.incision import trocar_force
from moc_opt.control.safety_filter import SafetyFilterSettings
from moc_opt.live import LiveRun
from moc_opt.scenario import Scenario, run

QUICK = {"bound_samples": 0, "judge": False}

# The wall begins so far inside the limits that the circle leads joint 4 into it.
WALL = {"position_margin_rad": 0.62}
OFF = {"rcm_error_m": None, "trocar_force_N": None, "motion": False}
STIFF = {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0}
MOC = {**STIFF, "K_N2": 80.0, "D_N2": 1.0, "limit_margin_rad": 0.0}
LAWS = {
    "moc": MOC, "tuned": {"preset": "tuned", "limit_margin_rad": 0.0}, "dcac": {"law": "dcac", **STIFF},
    "c": {**MOC, "backend": "c"},
}  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_the_force_agrees_with_the_plant(robot, seed):
    """In a run with wrong masses and noise: within half a newton of the truth, once means are taken."""
    trace = run(Scenario(seed=seed, control={"preset": "tuned"}, faults={"slip_m": 0.01}, duration_s=3.0, **QUICK))
    wrenches = np.hstack([trace.force_N, trace.torque_Nm])
    felt = np.array([
        trocar_force(robot.tool_pose(q), p, w, robot.data.tool_mass, robot.data.tool_length, np.inf)
        for q, p, w in zip(trace.q_rad, trace.trocar_registered_m, wrenches, strict=True)
    ])  # fmt: skip
    true = np.linalg.norm(trace.trocar_force_N, axis=1)
    assert true.max() > 7.0
    for part in (slice(250, 950), slice(1150, None)):  # before and after the slip
        assert np.sqrt(np.mean(felt[part] ** 2)) == pytest.approx(np.sqrt(np.mean(true[part] ** 2)), abs=0.5)


@pytest.mark.parametrize("control", LAWS.values(), ids=LAWS)
def test_an_arm_at_its_wall_is_stopped(control):
    """Without the limit on the RCM error it goes on to the end, 14 mm and 11 N off and more: the tip is fine."""
    blind = run(Scenario(control=control, guard={**WALL, **OFF}, **QUICK))
    assert blind.meta["ended"] == "completed"
    assert blind.rcm_error_m.max() > 0.014
    assert np.linalg.norm(blind.trocar_force_N, axis=1).max() > 11.0
    assert {w["of"] for w in blind.meta["warnings"]} == {"the RCM error", "the trocar's force"}
    trace = run(Scenario(control=control, guard=WALL, **QUICK))
    assert trace.meta["ended"].startswith("stopped: the RCM error has been above 12 mm")
    stop = trace.t_s >= trace.meta["stopped_at_s"]
    assert trace.rcm_error_m.max() < 0.0145
    # the tissue's spring pushes the arm back, its brakes open, until they close at half of stop_yield_N
    force = np.linalg.norm(trace.trocar_force_N[stop], axis=1)
    assert force.max() < 11.0
    assert force[-1] < 0.5 * SafetyFilterSettings().stop_yield_N + 0.5
    assert np.linalg.norm(trace.tip_m[stop] - trace.tip_m[stop][0], axis=1).max() < 0.03
    assert np.abs(trace.v_rad_per_s[stop]).max() < 0.3
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.03
    [rcm, _] = trace.meta["warnings"]
    assert rcm["of"] == "the RCM error"
    assert 0.0 < rcm["first_s"] < trace.meta["stopped_at_s"]


@pytest.mark.parametrize("control", LAWS.values(), ids=LAWS)
def test_a_trocar_that_tears_away_is_felt(control):
    """The registered trocar stays where it was, so only the force can tell."""
    scenario = Scenario(control=control, faults={"slip_m": 0.1, "slip_at_s": 1.5}, **QUICK)
    trace = run(scenario)
    assert trace.meta["ended"].startswith("stopped: the trocar's force has been above 15 N")
    assert 1.5 < trace.meta["stopped_at_s"] < 1.6
    deaf = run(scenario.change(guard=OFF))
    assert deaf.meta["ended"] == "completed"
    assert np.linalg.norm(deaf.trocar_force_N, axis=1).max() > 75.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("preset", ["default", "tuned", "robust", "paper"])
@pytest.mark.parametrize("law", ["moc", "dcac"])
def test_sound_runs_are_not_stopped(preset, law, seed):
    """Nor warned of, but for the paper's parameters, whose runs are up to 9 mm off."""
    control = {"law": law} if preset == "default" else {"law": law, "preset": preset}
    path = ("circle", "sinusoid", "spiral", "line")[seed]
    trace = run(Scenario(control=control, seed=seed, start={"swivel": "random"}, task={"path": path}, **QUICK))
    assert not trace.meta["ended"].startswith("stopped")
    if preset != "paper":
        assert "warnings" not in trace.meta


def test_a_live_run_is_stopped_with_its_brakes():
    live = LiveRun(Scenario(control=LAWS["tuned"], guard=WALL))
    live.advance(3000)
    stopped = live.moment()
    assert "the RCM error has been above 12 mm" in stopped.stopped
    assert "reset" in live.messages[-1]
    begun = live._loop._stopped_at
    watched = round(live.scenario.guard.stop_s / live.period_s) + 1
    assert stopped.t_s == pytest.approx((begun + watched) * live.period_s)
    assert begun > 0
    assert np.abs(live._setup.plant.v).max() < 0.03  # half a second of brakes, not a frozen picture of a moving arm
    live.advance(100)
    assert live.moment().t_s == stopped.t_s
    live.reset()
    live.advance(100)
    assert not live.moment().stopped
