"""Build the objects of a scenario, and run it."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.control import Controller
from moc_opt.control.controller import Guide
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.errors import ScenarioError, describe, named
from moc_opt.inputs.files import read_arrays
from moc_opt.planning.follow import Follower
from moc_opt.planning.guides import Following, guides
from moc_opt.planning.self_motion import require_freedom
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.derived import against_best, largest_mu, model_errors, residual_columns
from moc_opt.scenario.layout import described, lay_out, seeds_of
from moc_opt.scenario.planned import targets_of
from moc_opt.sim.faults import Faults
from moc_opt.sim.loop import ClosedLoop, simulate
from moc_opt.sim.mjcf import check_engines
from moc_opt.sim.plant import Plant, Stop
from moc_opt.sim.protocols import LoggedController, TorqueController
from moc_opt.sim.record import Columns, RunAway, TaskOffset
from moc_opt.solvers.base import Solver
from moc_opt.solvers.faulty import Faulty, draw
from moc_opt.solvers.isolated import Isolated
from moc_opt.solvers.registry import check_solver, find
from moc_opt.tasks import Trocar
from moc_opt.trace.file import new_file
from moc_opt.trace.oscillation import judged_for_oscillation
from moc_opt.trace.trace import Trace


def make_solver(name: str, robot: RobotModel, **settings: Any) -> Solver:
    """Create a solver, with the arm's kinematics if the solver takes them."""
    entry = find(name)
    if "kinematics" not in settings and "kinematics" in entry.parameters:
        settings = {**settings, "kinematics": robot.kinematics()}
    return entry.create(**settings)


def isolated(solver: Solver, scenario: Scenario, budget_us: float = math.inf, realtime: bool = False) -> Solver:
    """Put a solver in its own process if ``[solver] isolation`` asks for it. Raise a SolverError if pickle fails."""
    if scenario.solver.isolation == "none":
        return solver
    return Isolated(solver, scenario.solver.process, budget_us, waits=not realtime)


def make_safety_filter(robot: RobotModel, scenario: Scenario) -> SafetyFilter:
    """Make the scenario's safety filter."""
    return SafetyFilter(robot, scenario.safety_settings, scenario.plant.period_s)


def make_stop(scenario: Scenario) -> Stop:
    """Make the scenario's `Stop`."""
    return Stop(scenario.guard.stop_damping_Nm_s_per_rad, scenario.guard.stop_s)


def recorded_times(scenario: Scenario) -> list[float] | None:
    """Read the solve times ``[solver] replay_us`` [us]. Return None if solve times are measured."""
    given = scenario.solver.replay_us
    if given is None:
        return None
    what = "[solver] replay_us"
    read = read_arrays(given, what, ScenarioError) if isinstance(given, str) else {"": np.asarray(given)}
    times = read.get("", np.empty(0))
    if times.dtype.kind not in "fiu" or times.ndim != 1 or not len(times) or not (times >= 0.0).all():
        raise ScenarioError(f"{what} has type {times.dtype} and shape {times.shape}: give a list of times >= 0 us")
    return [float(time) for time in times]


class Setup:
    """Objects built from a scenario, and checked before anything moves.

    Args:
        solver: used instead of the scenario's solver.
        realtime: build only the controller, because the plant runs in another process.

    Raises:
        MocOptError: the scenario is not usable.
    """

    def __init__(self, scenario: Scenario, solver: Solver | None = None, *, realtime: bool = False) -> None:
        if solver is not None:
            check_solver(solver)
        self.scenario, self._given, self.realtime = scenario, solver, realtime
        _, plant_seed, self._fault_seed = seeds_of(scenario)
        self.robot = scenario.robot.arm()
        check_engines(self.robot)
        if scenario.control.law == "moc":
            require_freedom(self.robot)
        self.layout = layout = lay_out(scenario, self.robot)
        self.q_start, self.registered, self.reference = layout.q, layout.registered, layout.reference
        self.duration_s = layout.duration_s
        self.guide: Guide | None = None  #: Motion that the controller follows; None: level 3 raises mu.
        self._replayed_us = recorded_times(scenario)
        if not realtime:
            self._build_plant(plant_seed)

    def _build_plant(self, seed: int) -> None:
        scenario, entry = self.scenario, self.layout.trocar
        self.plant = plant = Plant(self.robot.data, scenario.plant, seed=seed)
        if scenario.faults.bump_N > 0.0:  # raises before the run if the link is unknown
            plant.push(scenario.faults.bump_link, np.zeros(3))
        plant.reset(self.q_start)
        self.offset = TaskOffset()
        if plant.mismatch.displaces or plant.settings.elastic:
            shaft, tip = plant.tip - plant.wrist, self.robot.state(self.q_start).tip
            touched = plant.tip - scenario.trocar.depth_m * shaft / np.linalg.norm(shaft)
            self.offset = TaskOffset(plant.tip - tip, touched - entry)
        true = entry + self.offset.trocar + plant.mismatch.registration_error
        self.trocar = Trocar(true, *scenario.trocar.breathing)

    def solver(self) -> Solver | None:
        """Make the scenario's solver. Return None if ``[control] law`` is not "moc"."""
        if self.scenario.control.law != "moc":
            return None
        asked, faults = self.scenario.solver, self.scenario.faults
        with named("[solver]"):
            solver = self._given or make_solver(asked.name, self.robot, **asked.settings)
        if faults.solver == "none" or faults.solver == "hang":
            return solver
        return Faulty(solver, faults.solver, faults.solver_share, self._fault_seed)

    def controller(self) -> LoggedController:
        """Make the scenario's controller."""
        scenario, solver = self.scenario, self.solver()
        settings, period_s = scenario.control, scenario.plant.period_s
        budget = settings.supervisor.budget_us
        times: Iterator[float] | None = None if self._replayed_us is None else itertools.cycle(self._replayed_us)
        if solver is not None:
            if scenario.faults.solver == "hang":
                # With replayed times, the seed alone decides which ticks are late.
                budget = budget or scenario.deadline_us
                times = iter(np.where(self.fault_mask(), 10.0 * budget, 0.0))
            wait_us = 0.5e6 * period_s if self.realtime else math.inf
            if budget is not None and times is None:
                wait_us = budget
            inside, solver = solver, isolated(solver, scenario, wait_us, self.realtime)
            if solver is not inside and times is None:
                budget = None  # the isolated solver watches the budget
        watch = settings.supervisor.model_copy(update={"budget_us": budget})
        settings = settings.model_copy(update={"supervisor": watch})
        self.guide = None if self._new_guide is None else self._new_guide()
        return Controller(self.robot, settings, solver, period_s, times, self.guide)

    @property
    def following(self) -> Following:
        """The data for planning a course."""
        scenario = self.scenario
        return Following(
            self.robot, self.q_start, scenario.control, partial(targets_of, self.robot, self.layout),
            scenario.guard.wall_brake_rad_per_s2, scenario.plant.period_s,
        )  # fmt: skip

    @cached_property
    def _new_guide(self) -> Callable[[], Guide] | None:
        """A function that makes a `Guide`; None: level 3 raises mu."""
        return guides(self.following)

    def fault_mask(self) -> NDArray[np.bool_]:
        """Return flags (N,), true at ticks with a fault of the solver."""
        faults = self.scenario.faults
        never = faults.solver == "none" or self.scenario.control.law != "moc"
        return draw(self._fault_seed, 0.0 if never else faults.solver_share, self.ticks)

    def closed_loop(self, controller: TorqueController) -> ClosedLoop:
        """Make the closed loop, without faults."""
        scenario = self.scenario
        return ClosedLoop(self.plant, controller, make_safety_filter(self.robot, scenario), make_stop(scenario))

    @property
    def ticks(self) -> int:
        """Number of ticks of the whole run."""
        return max(1, round(self.duration_s / self.scenario.plant.period_s))

    def times(self) -> Array:
        """Return the start of every tick [s]."""
        return self.scenario.plant.period_s * np.arange(self.ticks, dtype=np.float64)

    def inputs(self) -> tuple[Array, Array]:
        """Return X_d, dX_d, ddX_d (N, 3, 3) of the tip and P_t, dP_t (N, 2, 3) of the registered trocar."""
        tip_refs, registered = (np.stack(of.at(self.times()), axis=1) for of in (self.reference, self.registered))
        return tip_refs, registered

    def trace(self, watch: Callable[[int], None] | None = None, to: str | os.PathLike[str] | None = None) -> Trace:
        """Run, and return the trace; see `run`."""
        file = None if to is None else new_file(to).absolute()
        if self.plant.time > 0.0:
            self.plant.reset(self.q_start)
        meta = {
            **described(self.scenario, self.robot), "deadline_us": self.scenario.deadline_us,
            "start_q_rad": self.q_start.tolist(), **({"solver": self._given.name} if self._given else {}),
        }  # fmt: skip
        rows, broken = dict[str, NDArray[Any]](), None
        try:
            try:
                with contextlib.chdir("."):  # a solver may change the working directory
                    found = self._simulate(watch, meta, rows.update)
            except RunAway as error:
                found, broken = error.trace, error
            rows.update(found.columns)
            trace = self._judged(found)
        except BaseException as error:
            if file is not None and rows:
                self._save_rest(rows, meta, file, error)
            raise
        if file is not None:
            trace.save(file)
        if broken is not None:
            raise RunAway(str(broken), trace) from broken
        return trace

    def _simulate(
        self, watch: Callable[[int], None] | None, meta: Mapping[str, Any], rescue: Callable[[Columns], None]
    ) -> Trace:
        wrong, times, (tip_refs, registered) = self.scenario.faults, self.times(), self.inputs()
        faults = Faults(wrong, self.robot.n, self.scenario.plant.period_s, self._fault_seed)
        trocars = faults.slip(np.stack(self.trocar.at(times), axis=1), times)
        found = simulate(
            self.plant, self.controller(), tip_refs, trocars, registered,
            safety_filter=make_safety_filter(self.robot, self.scenario),
            faults=faults if wrong.around_the_arm else None, stop=make_stop(self.scenario), offset=self.offset,
            watch=watch, meta=meta, rescue=rescue,
        )  # fmt: skip
        if not isinstance(self.guide, Follower):
            return found
        told = {"course_mu_mean": self.guide.course_mu_mean, "replans": self.guide.told or None}
        return found.with_meta(**{name: value for name, value in told.items() if value is not None})

    def _judged(self, found: Trace) -> Trace:
        trace = found.with_columns(**self._row_by_row(found.columns))
        trace = judged_for_oscillation(trace, self.robot.data.joint_names, self.robot.chain.prismatic)
        bound, method = largest_mu(trace.q_rad, self.robot, self.scenario.bound_samples)
        best, told = against_best(self.scenario, trace) if self.scenario.best_courses else ({}, {})
        return trace.with_columns(mu_bound=bound, **best).with_meta(**method, **told)

    def _save_rest(self, rows: Columns, meta: Mapping[str, Any], file: Path, error: BaseException) -> None:
        ticks, period_s = len(rows["t_s"]), self.scenario.plant.period_s
        ended = f"interrupted: {describe(error)} (t = {ticks * period_s:.3f} s)"
        told = {"period_s": period_s, "ended": ended, "ticks": ticks, "ticks_planned": self.ticks}
        Trace({**rows, **self._row_by_row(rows)}, {**told, **meta}).save(file)
        error.add_note(f"the first {ticks * period_s:.3f} s of the run are in {file}")

    def _row_by_row(self, columns: Mapping[str, NDArray[Any]]) -> Columns:
        found: Columns = {}
        if self.scenario.faults.solver != "none":
            found["injected"] = self.fault_mask()[: len(columns["t_s"])]
        found |= model_errors(columns, self.robot, self.plant, self.offset)
        found["mu"] = self.robot.mu_along(columns["q_rad"])
        return found | (residual_columns(columns) if self.scenario.judge else {})


def run(
    scenario: Scenario | str | os.PathLike[str], watch: Callable[[int], None] | None = None,
    to: str | os.PathLike[str] | None = None, *, solver: Solver | None = None,
) -> Trace:  # fmt: skip
    """Run one scenario.

    Args:
        scenario: a scenario, or the path of its file.
        watch: called before every tick, with the tick's number.
        to: a Parquet file for the trace. After an exception such as Ctrl-C, it has the rows so far.
        solver: used instead of the scenario's solver.

    Returns:
        The trace, one row per tick. ``meta["ended"]`` says how the run ended.

    Raises:
        MocOptError: the scenario or the trace's file is not usable.
        RunAway: the simulation of the plant diverged. The error has the trace.
    """
    return Setup(Scenario.load(scenario), solver).trace(watch, to)
