"""The whole controller in C beside the Python one and its safety filter: the same torque to 1e-9 Nm at every tick."""

from __future__ import annotations

import itertools
import shutil
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import moc_opt.sim.closed_loop
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.embedded import compiler, guarded
from moc_opt.embedded.export import safe_files
from moc_opt.embedded.guarded import FAULTS, GuardedController
from moc_opt.embedded.support import TickSpec
from moc_opt.model.robot_model import RobotModel
from moc_opt.scenario import Scenario, Setup, make_safety_filter, steps
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim.filtered import FilteredController
from moc_opt.sim.sensors import Measurement

Array = NDArray[np.float64]
SAME_NM = 1e-9
PERIOD = Scenario().plant.period_s

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler (cc, gcc, clang) on the path"
)


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Libraries of this test run only; each program is written and compiled once."""
    written: dict[str, Any] = {}

    def once(spec: TickSpec, guard: SafetyFilterSettings) -> Any:
        key = repr((spec.robot.data, *spec[1:], guard))
        if key not in written:
            written[key] = safe_files(spec, guard)
        return written[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(guarded, "safe_files", once)
        yield


class Twin:
    """Python's `FilteredController`, and the C program on the same inputs; what differs is kept."""

    def __init__(self, brain: ControllerAdapter, guard: SafetyFilter, sent: Array, scenario: Scenario) -> None:
        self.python, self.brain, self.guard, self._sent = FilteredController(brain, guard, sent), brain, guard, sent
        controller = brain.controller
        self.c = GuardedController(
            controller.robot, controller.settings, controller.solver, scenario.plant.period_s, scenario.told_guard
        )
        self.differences: list[float] = []
        self.faults: Counter[str] = Counter()
        self.limited_ticks = self.opened = 0

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        self.python.start(seen, tip_ref, trocar)
        self.c.start(seen.q, seen.v, self._sent, seen.stamp)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        with np.errstate(all="ignore"):  # inputs of 1e300 overflow
            tau = self.python.tick(seen, tip_ref, trocar)
        solve_us = self.brain.controller.solve_us
        solve_us = 0.0 if np.isnan(solve_us) else solve_us
        found = self.c.tick(seen.q, seen.v, tip_ref, trocar, seen.force, seen.stamp, solve_us)
        self.differences.append(float(np.abs(found - tau).max()))
        assert self.python.stop_reason.startswith(self.c.reason), (self.python.stop_reason, self.c.reason)
        assert bool(self.python.stop_reason) == bool(self.c.reason)
        assert self.c.limited == self.python.limited
        if not self.python.stop_reason and self.brain.controller.solver is not None:
            assert self.c.fault == self.brain.controller.fault.label
            self.faults[self.c.fault] += 1
        self.limited_ticks += self.c.limited > 0
        if not self.python.stop_reason:
            there, here = self.c.remembered, self.remembered
            if not (np.abs(there - here) <= 1e-8 + 1e-7 * np.abs(here)).all():  # in a tenth of the time
                np.testing.assert_allclose(there, here, rtol=1e-7, atol=1e-8)
        return tau

    @property
    def remembered(self) -> Array:
        """What Python remembers, in the order of `GuardedController.remembered`: a level may never be reached."""
        guard, supervisor = self.guard, self.brain.controller._supervisor
        return np.concatenate([
            [*guard._square, *guard._incision.means, guard._press], supervisor._good, guard._motion.memory.ravel(),
            guard._motion.tip, guard._motion.still[:3], guard._motion.still[9:],
        ])  # fmt: skip

    def brake_friction(self, seen: Measurement) -> Array | float:
        friction, found = self.python.brake_friction(seen), self.c.hold(seen.force)
        self.differences.append(float(np.abs(found - friction).max()))
        self.opened += not friction.any()
        return friction

    @property
    def stop_reason(self) -> str:
        return self.python.stop_reason

    @property
    def limited(self) -> int:
        return self.python.limited

    @property
    def warnings(self) -> list[dict[str, Any]]:
        return self.python.warnings


def run_twins(scenario: Scenario) -> tuple[Twin, Any]:
    """Run the scenario's closed loop with both; Python's torque goes to the plant."""
    twins: list[Twin] = []

    def make(brain: ControllerAdapter, guard: SafetyFilter, sent: Array) -> Twin:
        twins.append(Twin(brain, guard, sent, scenario))
        return twins[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(moc_opt.sim.closed_loop, "FilteredController", make)
        patch.setattr(steps, "compiled_steps", lambda *parts: None)  # which would step past the twins
        trace = Setup(scenario).trace()
    return twins[0], trace


def scenario_of(**tables: Any) -> Scenario:
    return Scenario(**{"judge": False, "bound_samples": 0, "duration_s": 2.5, **tables})


NARROW = {"k0_per_s": 0.1, "speed_fraction": 0.15}
"""A box in which the references are infeasible for long stretches."""
UNTOLD = {"repeat_reading_ticks": 10**6}
"""Encoders whose velocities may repeat themselves: what is frozen is found by the other signs."""
COARSE = {"encoder_noise_rad": 0.0, "encoder_resolution_rad": 5e-4}
RUNS: dict[str, dict[str, Any]] = {
    "sound": {},
    "tuned": {"control": {"preset": "tuned"}},
    "paper": {"control": {"preset": "paper"}},
    "dcac": {"control": {"law": "dcac"}},
    "dcac-damped": {"control": {"law": "dcac", "dcac_damping": 3.0}},
    "bridged": {"faults": {"nan_at_s": 0.8, "nan_ticks": 3}},
    "nan": {"faults": {"nan_at_s": 0.8, "nan_ticks": 9999}},
    "jump": {"faults": {"jump_at_s": 0.8, "jump_rad": 0.2}},
    "drops": {"faults": {"drop_share": 0.05}},
    "late-packets": {"faults": {"late_ticks": 2}},
    "frozen": {"faults": {"frozen_at_s": 0.8}},
    "frozen-told": {"faults": {"frozen_at_s": 0.8, "forged_stamps": True}},
    "frozen-joint-told": {"faults": {"frozen_at_s": 0.8, "frozen_joint": 2}},
    "frozen-forged": {"faults": {"frozen_at_s": 0.8, "forged_stamps": True}, "guard": UNTOLD},
    "frozen-forged-still": {"faults": {"frozen_at_s": 0.3, "forged_stamps": True, "frozen_velocity": "zero"},
                            "guard": UNTOLD},
    "frozen-forged-rest": {"faults": {"frozen_at_s": 0.5, "forged_stamps": True}, "task": {"wait_s": 2.2},
                           "guard": UNTOLD,
                           "control": {"law": "dcac", "observer_gain_per_s": 0.0}},
    "frozen-forged-way": {"faults": {"frozen_at_s": 0.45, "forged_stamps": True},
                          "control": {"law": "dcac", "observer_gain_per_s": 0.0},
                          "guard": {"repeat_torque": 10.0, "repeat_whole_torque": 10.0, "repeat_whole_ticks": 10_000,
                                    "repeat_joint_ticks": 10_000, **UNTOLD,
                                    "motion_rad": 1.0}},
    "frozen-joint": {"faults": {"frozen_at_s": 0.8, "frozen_joint": 2, "frozen_velocity": "zero"}, "guard": UNTOLD},
    "frozen-joint-heavy": {"faults": {"frozen_at_s": 0.8, "frozen_joint": 2, "frozen_velocity": "zero"},
                           "guard": {"residual_torque": 10.0, **UNTOLD}},
    "frozen-joint-noise": {"faults": {"frozen_at_s": 0.8, "frozen_joint": 3, "frozen_velocity": "zero"},
                           "guard": {"residual_torque": 10.0, "stuck_rad_per_s": 10.0, **UNTOLD}},
    "coarse": {"plant": COARSE},
    "frozen-joint-coarse": {"plant": COARSE, "faults": {"frozen_at_s": 0.8, "frozen_joint": 3}},
    "frozen-wrench": {"faults": {"frozen_at_s": 0.4, "frozen_wrench": True}},
    "lagging-joint": {"faults": {"lag_at_s": 0.5, "lag_joint": 3, "lag_growth": 0.05}},
    "lagging-joint-at-once": {"faults": {"lag_at_s": 0.5, "lag_joint": 3, "lag_ticks": 12, "lag_growth": 1e-6}},
    "frozen-bridged": {"faults": {"frozen_at_s": 0.8, "frozen_ticks": 3}},
    "lagging": {"faults": {"lag_at_s": 0.8}},
    "lagging-told": {"faults": {"lag_at_s": 0.8, "forged_stamps": True}},
    "lagging-forged": {"faults": {"lag_at_s": 0.8, "forged_stamps": True}, "guard": UNTOLD},
    "replayed": {"faults": {"replay_at_s": 0.8}},
    "replayed-forged": {"faults": {"replay_at_s": 0.8, "forged_stamps": True}},
    "replayed-at-rest": {"faults": {"replay_at_s": 1.8, "replay_ticks": 80, "forged_stamps": True},
                         "control": {"law": "dcac"}, "task": {"wait_s": 2.5}},
    "replayed-at-rest-quiet": {"faults": {"replay_at_s": 1.8, "replay_ticks": 80, "forged_stamps": True},
                               "control": {"law": "dcac"}, "task": {"wait_s": 2.5},
                               "plant": {"force_noise_N": 0.0, "torque_noise_Nm": 0.0}},
    "drifting": {"faults": {"drift_rad_per_s": 0.3, "drift_at_s": 0.5}},
    "frozen-whole-at-rest": {"faults": {"frozen_at_s": 0.4, "forged_stamps": True, "frozen_velocity": "zero"},
                             "task": {"wait_s": 2.0},
                             "guard": {"repeat_whole_torque": 1.0, "stuck_torque": 1.0, "stuck_friction": 1e3,
                                       **UNTOLD}},
    "unwatched": {"faults": {"frozen_at_s": 0.8, "forged_stamps": True}, "guard": {"motion": False}},
    "never-yielding": {"faults": {"slip_m": 0.1, "slip_at_s": 0.8}, "guard": {"stop_yield_N": None}},
    "noise": {"faults": {"encoder_noise_rad": 5e-5}},
    "bump": {"faults": {"bump_N": 120.0, "bump_at_s": 0.8}},
    "payload": {"faults": {"payload_kg": 2.0}},
    "payload-whole": {"faults": {"payload_kg": 2.0},
                      "guard": {"residual_torque": 10.0, "residual_whole_torque": 0.05}},
    "slip": {"faults": {"slip_m": 0.1, "slip_at_s": 0.8}},
    "slip-loaded": {"faults": {"slip_m": 0.07, "slip_at_s": 0.8, "payload_kg": 1.0},
                    "guard": {"stop_yield_s": 0.1}},
    "violent": {"control": {"ramp_s": 0.0, "speed_fraction": 1.0, "K_N2": 80.0}, "start": {"swivel": "random"}},
    "rate": {"guard": {"torque_rate_Nm_per_s": 100.0, "tip_error_m": 0.1}},
    "infeasible-damping": {"control": {**NARROW, "fallback": "damping"}},
    "infeasible-least": {"control": {**NARROW, "fallback": "least-violation"}},
    "infeasible-hold": {"control": {**NARROW, "fallback": "hold"}},
    "infeasible-hold-short": {"control": {**NARROW, "fallback": "hold", "supervisor": {"hold_ticks": 0}}},
    "infeasible-hold-damping": {
        "control": {**NARROW, "fallback": "hold", "supervisor": {"hold_ticks": 3, "keep_off_limits": False}}
    },
    "walls": {"control": {"limit_margin_rad": 0.3, "fallback": "hold"}, "guard": {"position_margin_rad": 0.3},
              "start": {"q_rad": [0.595, -0.89, -1.0, 1.75, 0.77, -1.79, 0.0], "check_path": False}},
    "incision-warning": {"faults": {"slip_m": 0.02, "slip_at_s": 0.8},
                         "guard": {"trocar_force_warning_N": 0.5, "rcm_warning_m": 1e-4}},
    "pressing-tip": {"faults": {"drift_rad_per_s": 0.3, "drift_at_s": 0.5}, "guard": {"tip_force_N": 0.5}},
    "incision-off": {"faults": {"slip_m": 0.1, "slip_at_s": 0.8},
                     "guard": {"trocar_force_N": None, "rcm_error_m": None, "trocar_force_warning_N": None}},
}  # fmt: skip


OPTIMIZED = {"tuned", "paper", *(name for name, tables in RUNS.items() if not {"control", "guard"} & tables.keys())}
"""Compiled as users compile it; the others, each a program of its own, as `quickly` does."""


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """A function after which this test compiles without optimization, in a quarter of the time."""
    return lambda: monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, "-O0"))


@pytest.mark.parametrize("name", RUNS)
def test_a_run_has_the_same_torque_at_every_tick(name: str, quickly: Callable[[], None]) -> None:
    if name not in OPTIMIZED:
        quickly()
    scenario = scenario_of(**RUNS[name])
    twin, trace = run_twins(scenario)
    assert len(twin.differences) >= len(trace) > 100
    assert max(twin.differences) <= SAME_NM
    ended = trace.meta["ended"]
    # Each run has to be what it is here for.
    stops = {
        "nan": "measurements", "jump": "measurements",
        "slip": "the trocar's force", "slip-loaded": "the trocar's force",
        "frozen-told": "all encoders repeat", "frozen-joint-told": "one encoder repeats",
        "lagging-told": "all encoders repeat", "lagging-joint": "one encoder repeats",
        "lagging-joint-at-once": "one encoder lags",
        "frozen-wrench": "the wrench sensor repeats", "frozen-joint-coarse": "an encoder repeats",
        "frozen": "measurements are more", "frozen-forged": "the encoders' positions",
        "frozen-forged-still": "all encoders repeat", "frozen-forged-rest": "all encoders repeat",
        "frozen-forged-way": "all encoders repeat", "frozen-joint": "the measured motion is not",
        "frozen-whole-at-rest": "all encoders repeat", "replayed-at-rest": "the measurements are a recording",
        "replayed-at-rest-quiet": "the measurements are a recording",
        "frozen-joint-heavy": "an encoder repeats", "frozen-joint-noise": "one encoder repeats",
        "lagging": "measurements are more", "unwatched": "the tip", "payload-whole": "the measured motion is not",
    }  # fmt: skip
    if name in stops:
        assert ended.startswith(f"stopped: {stops[name]}")
    if name.startswith("slip"):
        assert twin.opened > 0  # of the brakes, while the trocar pressed
    if name in ("sound", "tuned", "dcac", "bridged", "frozen-bridged", "coarse"):
        assert ended == "completed"
        assert twin.limited_ticks == 0
    if name in ("violent", "rate", "walls"):
        assert twin.limited_ticks > 10
    if name.startswith("infeasible"):
        assert twin.faults["infeasible"] > 100
    if name == "incision-warning":
        python = {w["of"]: w for w in trace.meta["warnings"]}
        (rcm_tick, rcm), (force_tick, force) = twin.c.warned
        period = scenario.plant.period_s
        assert python["the RCM error"]["first_s"] == pytest.approx(rcm_tick * period)
        assert python["the RCM error"]["largest"] == pytest.approx(1e3 * rcm)
        assert python["the trocar's force"]["first_s"] == pytest.approx(force_tick * period)
        assert python["the trocar's force"]["largest"] == pytest.approx(force)
    counts = twin.brain.faults
    assert {label: twin.c.count(label) for label in FAULTS[1:] if twin.c.count(label)} == {
        label: entry["count"] for label, entry in counts.items()
    }


@pytest.mark.parametrize("late", ["hold", "zero", "iterate"])
def test_late_answers_are_treated_alike(late: str, quickly: Callable[[], None]) -> None:
    """Recorded solve times, of which a quarter are beyond the budget, also many in a row."""
    if late != "hold":
        quickly()
    rng = np.random.default_rng(3)
    times = np.where(rng.uniform(size=1000) < 0.1, 500.0, 10.0)
    times[300:340] = 500.0
    supervisor = {"budget_us": 100.0, "late": late, "hold_ticks": 5}
    twin, _ = run_twins(
        scenario_of(solver={"replay_us": tuple(times)}, control={"preset": "tuned", "supervisor": supervisor})
    )
    assert twin.faults["late"] > 100
    assert max(twin.differences) <= SAME_NM


# ---- the straight elbow, from recorded measurements: no loop leads an arm there ------------------------------------


def stream(robot: RobotModel, angles: Array, seed: int, moving: float) -> list[tuple[Measurement, Array, Array]]:
    """Measurements with the elbow at these angles, the other joints drawn; references near the tip that is seen."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, robot.n) * [1.0, 0.5, 1.0, 0.0, 1.0, 0.5, 1.0]
    q[5], v = 0.9, moving * rng.normal(scale=0.1, size=robot.n)
    v[3], found = (angles[1] - angles[0]) / PERIOD, []
    for stamp, angle in enumerate(angles):
        q = q + PERIOD * v
        q[3] = angle
        state = robot.state(q, v)
        tip_ref = moving * rng.normal(size=(3, 3)) * [[1e-4], [1e-2], [1e-1]]
        tip_ref[0] += state.tip
        trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
        found.append((Measurement(q.copy(), v.copy(), np.zeros(6), stamp), tip_ref, trocar))
    return found


def compare_on(scenario: Scenario, given: list[tuple[Measurement, Array, Array]]) -> Twin:
    """Both, open loop, on the same measurements."""
    setup = Setup(scenario)
    guard = make_safety_filter(setup.robot, scenario)
    twin = Twin(ControllerAdapter(setup.controller()), guard, setup.robot.gravity(given[0][0].q), scenario)
    twin.start(*given[0])
    for inputs in given:
        twin.tick(*inputs)
    return twin


ELBOWS = {
    "straight": np.zeros(30),
    "nearly": np.full(30, 1e-5),
    "a-thousandth": np.full(30, -1e-3),
    "through": np.linspace(-0.03, 0.03, 61),  # zero is one of them
    "through-unseen": np.linspace(-0.03, 0.03, 60),
}


@pytest.mark.parametrize("elbow", ELBOWS)
@pytest.mark.parametrize(
    "control",
    [
        {}, {"fallback": "damping"}, {"fallback": "hold"}, {"fallback": "hold", "supervisor": {"hold_ticks": 2}},
        {"regularization": 0.0},
        {"preset": "paper"}, {"law": "dcac"}, {"law": "dcac", "dcac_damping": 3.0}, {"projector": "static"},
    ],
    ids=lambda control: "-".join(f"{value}" for value in control.values()) or "default",
)  # fmt: skip
def test_a_straight_elbow_has_the_same_torque(
    robot: RobotModel, elbow: str, control: dict[str, Any], quickly: Callable[[], None]
) -> None:
    if control:
        quickly()
    scenario = scenario_of(control=control, guard={"tip_error_m": 1.0, "rcm_error_m": None, "motion": False})
    solved = 0
    for seed, moving in itertools.product(range(3), (0.0, 1.0)):
        twin = compare_on(scenario, stream(robot, ELBOWS[elbow], seed, moving))
        assert max(twin.differences) <= SAME_NM
        assert np.isfinite(twin.differences).all()
        assert not twin.stop_reason
        solved += twin.faults["none"]
    if elbow == "straight" and scenario.control.law == "moc":
        assert len(twin.brain.controller.null_space) == 3  # rank four: the self-motion has a second freedom
        assert solved > 0


def test_what_is_no_number_is_treated_alike(robot: RobotModel) -> None:
    """One bad entry in one tick of a sound stream, of every input; five in a row; and numbers of any size."""
    angles = 1.2 + 1e-3 * np.arange(20)
    scenario = scenario_of(guard={"motion": False})  # measurements that no torque moves
    stopped = Counter()
    for bad, field, ticks in itertools.product((np.nan, np.inf, -1e300, 1e300), range(5), (1, 5)):
        given = stream(robot, angles, seed=1, moving=1.0)
        for k in range(8, 8 + ticks):
            arrays = [np.array(part) for part in (*given[k][0][:3], given[k][1], given[k][2])]
            arrays[field].flat[1] = bad
            given[k] = (Measurement(arrays[0], arrays[1], arrays[2], k), arrays[3], arrays[4])
        twin = compare_on(scenario, given)
        assert max(twin.differences) <= SAME_NM, (bad, field, ticks)
        stopped[twin.stop_reason.partition(" has been")[0]] += 1
        assert bool(twin.stop_reason) or (field < 3 and ticks == 1), (bad, field, ticks)
    assert len(stopped) >= 4, stopped
