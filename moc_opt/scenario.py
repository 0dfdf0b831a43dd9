"""How a scenario is put together and run: the only place that knows every room."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt import solvers
from moc_opt.control import Controller
from moc_opt.control.guard import Guard
from moc_opt.driver import Driver
from moc_opt.errors import MocOptError, RobotError, ScenarioError
from moc_opt.layout import breathing, lay_out
from moc_opt.model import RobotModel
from moc_opt.oscillation import judged_for_oscillation
from moc_opt.scenario_tables import Scenario
from moc_opt.selfmotion import self_motion
from moc_opt.sim.faults import Faults
from moc_opt.sim.loop import RunAway, Stop, Touched, simulate
from moc_opt.sim.plant import Plant
from moc_opt.sim.safe import Brain, Safe
from moc_opt.solvers.base import Solver, Status
from moc_opt.solvers.faulty import Faulty, draw
from moc_opt.solvers.registry import accepts
from moc_opt.subproblem import judge
from moc_opt.tasks import Trocar
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace import Trace

Array = NDArray[np.float64]


class Setup:
    """Objects built from a validated scenario: robot, plant, references; ``trace()`` runs it."""

    def __init__(self, scenario: Scenario) -> None:
        """Build and check everything before anything moves.

        Raises:
            MocOptError: the first thing that is wrong, in its own words; see `moc_opt.layout.lay_out` for the start and
                the path.
        """
        self.scenario = scenario
        start_seed, plant_seed, fault_seed = np.random.SeedSequence(scenario.seed).generate_state(3).tolist()
        self.robot = scenario.robot.arm()
        self.plant = Plant(self.robot.data, scenario.plant, seed=plant_seed)
        layout = lay_out(scenario, self.robot, np.random.default_rng(start_seed))
        self.q_start, self.registered, self.reference = layout.q, layout.registered, layout.reference
        self.duration_s = layout.duration_s
        if scenario.faults.bump_N > 0.0:  # an unknown link is found now, not in the middle of the run
            self.plant.push(scenario.faults.bump_link, np.zeros(3))
        self.plant.reset(self.q_start)
        self.touched = self._touch(layout.trocar, scenario.trocar.depth_m)
        entry = layout.trocar + self.touched.trocar
        self.trocar = Trocar(entry + self.plant.mismatch.registration_error, *breathing(scenario))
        self._fault_seed = fault_seed
        self._replayed_us = _recorded_times(scenario)

    def _touch(self, entry: Array, depth: float) -> Touched:
        """Lay the task where the arm's own tip is; ``entry`` (3,) [m] is where its model puts the incision.

        The incision lies on the shaft as it truly stands, and the path begins at the true tip.
        """
        plant = self.plant
        if not (plant.mismatch.displaces or plant.settings.elastic):
            return Touched.nothing()  # equal but for rounding
        shaft, tip = plant.tip - plant.wrist, self.robot.state(self.q_start).tip
        return Touched(plant.tip - tip, plant.tip - depth * shaft / np.linalg.norm(shaft) - entry)

    def solver(self) -> Solver | None:
        """The solver that the scenario asks for; None under DCAC."""
        if self.scenario.control.law != "moc":
            return None
        solver = make_solver(self.scenario.solver.name, self.robot, **self.scenario.solver.settings)
        faults = self.scenario.faults
        if faults.solver == "none" or faults.solver == "hang":
            return solver
        return Faulty(solver, faults.solver, faults.solver_share, self._fault_seed)

    def controller(self) -> Controller:
        """The law and solver that the scenario asks for."""
        settings, times = self.scenario.control, self._replay()
        if self.scenario.faults.solver == "hang" and settings.law == "moc":
            # Replayed times, not a clock: the same seed is late at the same ticks on any machine.
            watch = settings.supervisor
            budget = watch.budget_us or self.scenario.deadline_us
            settings = settings.model_copy(
                update={"supervisor": watch.model_copy(update={"budget_us": budget})}
            )
            # one more in front, because a tick is run for nothing before the loop
            times = itertools.chain([0.0], np.where(self.spoilt(), 10.0 * budget, 0.0))
        return Controller(self.robot, settings, self.solver(), self.scenario.plant.period_s, times)

    def _replay(self) -> Iterator[float] | None:
        """The recorded solve times from the start, their first one twice: a tick is run for nothing before the loop."""
        times = self._replayed_us
        return None if times is None else itertools.chain(times[:1], itertools.cycle(times))

    def spoilt(self) -> NDArray[np.bool_]:
        """At which ticks the solver's answer is spoilt on purpose, (N,)."""
        faults, ticks = self.scenario.faults, len(self.times())
        if faults.solver == "none" or self.scenario.control.law != "moc":
            return np.zeros(ticks, dtype=np.bool_)
        return draw(self._fault_seed, faults.solver_share, ticks)

    def brain(self) -> Brain:
        """The controller as the loop wants it, in Python or compiled."""
        if self.scenario.control.backend == "c":
            if self.scenario.faults.solver != "none":
                raise ScenarioError(
                    f"[faults] solver = {self.scenario.faults.solver!r}: a compiled tick has no solver to spoil; "
                    "take [control] backend = 'python'"
                )
            from moc_opt.embedded import NativeController  # late: nobody else needs CasADi and a compiler

            return NativeController(
                self.robot, self.scenario.control, self.solver(), self.scenario.plant.period_s
            )
        return Driver(self.controller())

    def times(self) -> Array:
        """Start of every tick [s]."""
        period = self.scenario.plant.period_s
        ticks = max(1, round(self.duration_s / period))
        return period * np.arange(ticks, dtype=np.float64)

    def trace(self, watch: Callable[[int], None] | None = None) -> Trace:
        """Run, judge, and return what is left behind."""
        t = self.times()
        if self.plant.time > 0.0:
            self.plant.reset(self.q_start)
        meta = {
            "scenario": self.scenario.model_dump(mode="json"), "deadline_us": self.scenario.deadline_us,
            "robot": self.robot.data.name, "start_q_rad": self.q_start.tolist(),
        }  # fmt: skip
        period, wrong = self.scenario.plant.period_s, self.scenario.faults
        faults = Faults(wrong, self.robot.n, period, self._fault_seed)
        trace = simulate(
            self.plant, self.brain(), np.stack(self.reference.at(t), axis=1),
            faults.slip(np.stack(self.trocar.at(t), axis=1), t), np.stack(self.registered.at(t), axis=1),
            guard=make_guard(self.robot, self.scenario), faults=faults if wrong.around_the_arm else None,
            stop=make_stop(self.scenario), touched=self.touched, watch=watch, meta=meta,
        )  # fmt: skip
        trace = judged_for_oscillation(trace, self.robot.data.joint_names)
        if wrong.solver != "none":
            trace = trace.with_columns(injected=self.spoilt()[: len(trace)])
        trace = self._with_model_error(trace)
        mu = self.robot.mu_along(trace.q_rad)
        return self._judged(trace.with_columns(mu=mu, mu_bound=self._mu_bound(trace)))

    def _with_model_error(self, trace: Trace) -> Trace:
        """With tip and RCM error as the robot's own kinematics have them; without, where its encoders see no links."""
        plant = self.scenario.plant
        if plant.elastic and plant.encoder_side == "motor":
            return trace
        if not self.plant.mismatch.displaces:
            return trace.with_columns(
                tip_error_model_m=trace.tip_error_m, rcm_error_model_m=trace.rcm_error_registered_m
            )
        tips, wrists = self.robot.tool_along(trace.q_rad + self.plant.mismatch.encoder_bias)
        told = trace.trocar_registered_m - self.touched.trocar
        return trace.with_columns(
            tip_error_model_m=np.linalg.norm(trace.tip_ref_m - tips, axis=1),
            rcm_error_model_m=shaft_distance(tips, wrists, told),
        )

    def _mu_bound(self, trace: Trace) -> Array:
        """Largest mu on the feasible self-motion, at evenly spaced ticks; NaN between them and where q is singular."""
        bound = np.full(len(trace), np.nan)
        samples = min(self.scenario.bound_samples, len(trace))
        for k in np.linspace(0, len(trace) - 1, samples).astype(int):
            inside = np.clip(trace.q_rad[k], self.robot.q_min, self.robot.q_max)
            try:
                bound[k] = self_motion(self.robot, inside).mu_best
            except RobotError:
                continue  # no single curve leads through a singular pose
        return bound

    def _judged(self, trace: Trace) -> Trace:
        if "subproblem" not in trace.columns or not self.scenario.judge:
            return trace
        found = judge(trace.subproblem, trace.x_rad_per_s, trace.dual)
        silent = ~np.isfinite(trace.x_rad_per_s).all(axis=1) & (trace.status != Status.SOLVED.label)
        columns = {name: np.where(silent, np.nan, figure) for name, figure in found._asdict().items()}
        return trace.with_columns(verified=found.verified(), **columns)


def _recorded_times(scenario: Scenario) -> list[float] | None:
    """The times of ``[solver] replay_us``, read and checked; None where the clock decides.

    Raises:
        ScenarioError: a file that holds no such times, or a controller that cannot take them.
    """
    given = scenario.solver.replay_us
    if given is None:
        return None
    if scenario.control.backend == "c":
        raise ScenarioError(
            "[solver] replay_us: the compiled tick takes no recorded times; take backend 'python'"
        )
    try:
        times = np.asarray(
            np.load(given, allow_pickle=False) if isinstance(given, str) else given, dtype=float
        )
    except (OSError, ValueError) as error:
        raise ScenarioError(f"[solver] replay_us = {given!r}: no .npy file of numbers: {error}") from error
    if times.ndim != 1 or times.size == 0 or not (np.isfinite(times) & (times >= 0.0)).all():
        raise ScenarioError(
            f"[solver] replay_us: shape {times.shape}: give one time of 0 us or more a tick, at least one"
        )
    return [float(time) for time in times]


def make_solver(name: str, robot: RobotModel, **settings: Any) -> Solver:
    """Create a solver, giving it the arm's kinematics where it can use them."""
    if "kinematics" not in settings and accepts(name, "kinematics"):
        settings = {**settings, "kinematics": robot.kinematics()}
    return solvers.create(name, **settings)


def make_guard(robot: RobotModel, scenario: Scenario) -> Guard:
    """The guard of an arm in its incision, with all that it can know."""
    return Guard(robot.data, scenario.guard, scenario.plant.period_s, robot.gravity, robot.tool_pose, robot.state)


def make_stop(scenario: Scenario) -> Stop:
    """How the guard's settings break a run off."""
    return Stop(scenario.guard.stop_damping_Nm_s_per_rad, scenario.guard.stop_s)


def run(scenario: Scenario, watch: Callable[[int], None] | None = None) -> Trace:
    """Run one scenario.

    Raises:
        MocOptError: what is wrong with it, before anything moves; or that the arm ran away.
    """
    return Setup(scenario).trace(watch)


__all__ = [
    "MocOptError", "RunAway", "Safe", "Scenario", "Setup", "make_guard", "make_solver", "make_stop", "run",
]  # fmt: skip
