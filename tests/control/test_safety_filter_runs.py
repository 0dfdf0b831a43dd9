"""The guard in whole runs: against a saboteur, lost sensors, controllers that break down; and the damped stop."""

import json

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.errors import ControlError, PlantError
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim import Plant, PlantSettings
from moc_opt.sim.loop import RunAway, Stop, simulate
from moc_opt.trace.trace import Trace

PERIOD = 0.002
N = 7
QUICK = {"bound_samples": 0, "judge": False}


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


@pytest.mark.parametrize("every", [1, 100, 10_000])
@pytest.mark.parametrize("seed", range(3))
def test_a_saboteur_gets_no_joint_past_its_limit(robot, every, seed):
    # Readings without bias: of 60 such courses one passes a limit by 0.01 rad, with a bias of 0.1 mrad three do.
    free = PlantSettings.realistic(trocar_stiffness_N_per_m=0.0, trocar_damping_Ns_per_m=0.0, encoder_bias_rad=0.0)
    plant = Plant(robot.data, free, seed=seed)
    place = 0.1 + 0.8 * np.random.default_rng(seed).uniform(size=N)
    plant.reset(robot.q_min + place * (robot.q_max - robot.q_min))
    ticks = 600
    guard = SafetyFilter(robot.data, SafetyFilterSettings(), PERIOD, robot.gravity)
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


@pytest.mark.parametrize(
    "control", [{"preset": "tuned"}, {"law": "dcac"}, {"law": "dcac", "gains": "dcac"}, {}],
)  # fmt: skip
def test_ordinary_runs_are_not_touched(control):
    trace = run(Scenario(control=control, **QUICK))
    assert not trace.limited.any()
    assert trace.meta["ended"] == "completed"


@pytest.mark.parametrize("seed", range(3))
def test_the_default_law_starts_gently(seed):
    """From any swivel: the guard has nothing to do, and the tip stays with its reference."""
    scenario = Scenario(start={"swivel": "random"}, seed=seed, duration_s=2.0, **QUICK)
    trace = run(scenario)
    assert not trace.limited.any()
    assert trace.tip_error_model_m.max() < 1e-3
    # without ramp and at the joints' own speed limits, as the paper has it, the guard must step in
    violent = run(scenario.change(control={"ramp_s": 0.0, "speed_fraction": 1.0}))
    assert violent.limited.any()
    assert violent.tip_error_model_m.max() > 1.2 * trace.tip_error_model_m.max()


@pytest.mark.parametrize("law", ["moc", "dcac"])
@pytest.mark.parametrize(
    "faults", [{"nan_at_s": 0.8, "nan_ticks": 9999}, {"jump_at_s": 0.8, "jump_rad": 0.2}], ids=["nan", "jump"]
)
def test_sensors_that_are_lost_stop_the_arm(law, faults):
    control = {"preset": "tuned"} if law == "moc" else {"law": "dcac"}
    scenario = Scenario(control=control, faults=faults, **QUICK)
    trace = run(scenario)
    assert trace.meta["ended"].startswith("stopped: measurements not believed")
    patience = 1e-9 + 0.8 + PERIOD * scenario.guard.patience_ticks
    assert trace.meta["stopped_at_s"] == pytest.approx(patience)
    assert trace.t_s[-1] == pytest.approx(patience + scenario.guard.stop_s)
    after = trace.t_s >= trace.meta["stopped_at_s"]
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.02
    assert np.linalg.norm(trace.tip_m[after] - trace.tip_m[after][0], axis=1).max() < 0.005
    if law == "moc":
        assert set(trace.fault[after]) == {"stopped"}
        assert set(trace.status[after]) == {"none"}
        assert np.isnan(trace.x_rad_per_s[after]).all()
        assert not (trace.fault[~after] == "stopped").any()


def test_a_bridged_gap_goes_unnoticed():
    clean, gap = (
        run(Scenario(control={"preset": "tuned"}, faults=f, duration_s=1.2, **QUICK))
        for f in ({}, {"nan_at_s": 0.8, "nan_ticks": 3})
    )
    assert gap.meta["ended"] == "completed"
    assert np.abs(gap.tip_m - clean.tip_m).max() < 1e-4


def test_the_weight_is_carried_and_the_last_push_is_not(robot):
    """In a stop the torque of the last pose's gravity coasts less far than holding the last torque would.

    Without the brakes' dry friction, which would hold the arm in either case.
    """

    class Holding(SafetyFilter):
        def stop_torque(self, before):
            return before

    travels = []
    for kind in (SafetyFilter, Holding):
        setup = Setup(Scenario(control={"preset": "tuned"}, **QUICK))
        ticks = 600
        t = PERIOD * np.arange(ticks)
        references = np.stack(setup.reference.at(t), axis=1)
        trocars = np.stack(setup.trocar.at(t), axis=1)
        guard = kind(robot.data, SafetyFilterSettings(stop_holding=0.0), PERIOD, robot.gravity)
        brain = ControllerAdapter(setup.controller())
        stop_at = 350

        def watch(k, guard=guard, plant=setup.plant, stop_at=stop_at):
            if k == stop_at - 20:
                plant.push("link_4", [30.0, 0.0, 0.0])
            if k == stop_at:
                plant.clear_pushes()
                guard.request_stop("for a test")

        trace = simulate(
            setup.plant, brain, references, trocars, np.stack(setup.registered.at(t), axis=1), safety_filter=guard,
            stop=Stop(40.0, 0.4), watch=watch,
        )  # fmt: skip
        assert trace.meta["ended"] == "stopped: for a test (t = 0.700 s)"
        travels.append(np.linalg.norm(trace.tip_m[stop_at:] - trace.tip_m[stop_at], axis=1).max())
        if kind is SafetyFilter:
            np.testing.assert_allclose(trace.tau_Nm[-1], robot.gravity(trace.q_rad[stop_at - 1]), atol=0.05)
    assert travels[0] < 0.7 * travels[1]


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


@pytest.mark.parametrize(
    ("how", "says"),
    [
        (ControlError("no idea"), "the controller failed: no idea"),
        (ZeroDivisionError("by zero"), "by zero"),
        (np.linalg.LinAlgError("SVD"), "SVD"),
        (float("nan"), "torque is not finite"),
        (float("inf"), "torque is not finite"),
    ],
)
def test_a_controller_that_breaks_down_stops_the_arm(robot, how, says):
    setup = Setup(Scenario(control={"preset": "tuned"}, **QUICK))
    t = PERIOD * np.arange(400)
    trace = simulate(
        setup.plant, Breaking(setup.controller(), how), *(np.stack(r.at(t), axis=1) for r in
        (setup.reference, setup.trocar, setup.registered)),
        safety_filter=SafetyFilter(robot.data, SafetyFilterSettings(), PERIOD, robot.gravity), stop=Stop(40.0, 0.3),
    )  # fmt: skip
    assert trace.meta["ended"].startswith("stopped: ")
    assert says in trace.meta["ended"]
    assert len(trace) == 100 + 150 + 1
    assert np.isfinite(trace.tau_Nm).all()
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.02


def test_an_unstable_loop_is_stopped():
    """Five ticks of delay are too many for these gains: the run says so instead of oscillating to its end.

    The torque of a tick long past does not go with the motion that is seen, and then the tip leaves its reference.
    """
    trace = run(
        Scenario(control={"preset": "tuned"}, plant={"preset": "realistic", "delay_ticks": 6}, **QUICK)
    )
    assert "off its reference" in trace.meta["ended"] or "not what the torque makes" in trace.meta["ended"]
    assert trace.t_s[-1] < 4.0
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.05
    assert trace.tip_error_m.max() < 0.05


@pytest.mark.parametrize("law", ["moc", "dcac"])
@pytest.mark.parametrize("plant", [{}, {"friction": 0.0}, {"trocar_stiffness_N_per_m": 3000.0}], ids=str)
def test_the_robust_gains_bear_four_ticks_of_delay(law, plant):
    """Also without friction to help, and against a stiff trocar: no joint begins to shake."""
    for seed in (0, 3):
        control = {"preset": "robust", "law": law}
        base = Scenario(control=control, start={"swivel": "random"}, seed=seed, duration_s=3.0, **QUICK)
        one, four = (run(base.change(plant={"delay_ticks": ticks, **plant})) for ticks in (1, 4))
        assert four.meta["ended"] == "completed"
        assert not four.limited.any()
        assert four.tip_error_model_m.mean() < 3e-4
        rates = [np.diff(trace.tau_Nm[500:], axis=0).std() for trace in (one, four)]
        assert rates[1] < 1.5 * rates[0]


def test_a_run_away_keeps_its_trace(robot):
    """Without a guard, a torque that is no number ends the run in the plant; the rows so far are kept."""
    setup = Setup(Scenario(control={"preset": "tuned"}, **QUICK))
    t = PERIOD * np.arange(400)
    paths = [np.stack(r.at(t), axis=1) for r in (setup.reference, setup.trocar, setup.registered)]
    with pytest.raises(RunAway, match="ran away") as found:
        simulate(setup.plant, Breaking(setup.controller(), float("nan")), *paths)
    assert isinstance(found.value, PlantError)
    assert len(found.value.trace) == 101
    assert found.value.trace.meta["ended"].startswith("ran away")
    assert np.isfinite(found.value.trace.q_rad).all()


def test_the_command_line_says_that_a_run_was_stopped(tmp_path, capsys):
    file, out = tmp_path / "s.toml", tmp_path / "t.parquet"
    file.write_text(
        'name = "blind"\nduration_s = 1.2\nbound_samples = 0\njudge = false\n[control]\nlaw = "dcac"\n'
        "[faults]\nnan_at_s = 0.1\nnan_ticks = 9999\n"
    )
    assert main(["run", str(file), "--trace", str(out)]) == 3
    said = capsys.readouterr()
    assert "blind: stopped: measurements not believed" in said.err
    assert Trace.load(out).meta["ended"].startswith("stopped")
    rows = [line.strip() for line in said.out.splitlines() if line.strip()]
    told = " ".join(rows[:2])  # the title has two lines at this width
    assert told.startswith("blind (first 0.6 s of 1.2 s): path circle, controller dcac, gains default, seed 0")
    ended = next(row for row in rows if row.startswith("ended"))
    assert ended.split()[:4] == ["ended", "stopped", "measurements", "not"]
    assert all("(part)" in row for row in rows if "_mean" in row or "_max" in row)
    assert main(["run", str(file), "--json"]) == 3

    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    found = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert next(iter(found)) == "ended"
    assert found["ended"].startswith("stopped: measurements not believed")
    assert found["part"] == "first 0.6 s of 1.2 s"
    assert found["completed"] == 0.0
    assert found["share_of_run"] == pytest.approx(len(Trace.load(out)) / 600)


def test_the_command_line_keeps_the_trace_of_a_run_away(tmp_path, capsys):
    file, out = tmp_path / "s.toml", tmp_path / "t.parquet"
    file.write_text(
        "duration_s = 0.1\nbound_samples = 0\n[plant]\ntrocar_stiffness_N_per_m = 1e6\ntrocar_damping_Ns_per_m = 1e4\n"
    )
    assert main(["run", str(file), "--trace", str(out)]) == 3  # the input is as it should be: the arm is not
    assert "s: ran away" in capsys.readouterr().err, "a run without a name has its file's"
    assert Trace.load(out).meta["ended"].startswith("ran away")


@pytest.mark.parametrize("law", ["moc", "dcac"])
@pytest.mark.parametrize("swivel", [0.0, 1.0])
def test_a_joint_that_begins_inside_its_wall_is_not_thrown_out_of_it(swivel, law):
    """At either end of the self-motion one joint stands on its limit; the wall used to throw the tip 25 mm off."""
    trace = run(Scenario(start={"swivel": swivel}, control={"law": law}, duration_s=1.5, **QUICK))
    assert trace.meta["ended"] == "completed"
    assert trace.tip_error_m.max() < 2e-3
    assert trace.rcm_error_m.max() < 4e-3


@pytest.mark.parametrize("start", [-1.0, 1.0])
def test_a_wall_that_begins_at_the_start_is_none_beyond_it(robot, start):
    """Where the joint began there is no torque; deeper in, the wall's; other joints keep their own."""
    settings = SafetyFilterSettings()
    guard = SafetyFilter(robot.data, settings, PERIOD, lambda q: np.zeros(N))
    q, rest = np.array(robot.data.q_home), np.zeros(N)
    q[1] = start * (robot.q_max[1] - 0.5 * settings.position_margin_rad)
    guard.start(q, rest)
    assert not guard.limit_torque(np.zeros(N), rest, q, rest).any()
    deeper = np.where(np.arange(N) == 1, q + 1e-3 * start, q)
    back = guard.limit_torque(np.zeros(N), rest, deeper, rest)
    assert back[1] == pytest.approx(-start * settings.wall_stiffness_Nm_per_rad * 1e-3)
    q[5] = robot.q_max[5] - 0.5 * settings.position_margin_rad
    assert guard.limit_torque(np.zeros(N), rest, q, rest)[5] < 0.0
    guard.start(np.array(robot.data.q_home), rest)  # another run has its whole walls again
    assert guard.limit_torque(np.zeros(N), rest, q, rest)[1] * start < 0.0
