"""Build the objects of a scenario: robot, plant, solver, controller, references."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.control import Controller
from moc_opt.control.guide import Guide
from moc_opt.planning.freedoms import require_freedom
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim.agreement import check_engines
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.guided import guides
from moc_opt.scenario.layout import breathing, lay_out, seeds_of
from moc_opt.scenario.parts import (
    check_solver,
    isolated,
    make_safety_filter,
    make_solver,
    make_stop,
    recorded_times,
)
from moc_opt.sim.loop import ClosedLoop
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import LoggedController, TorqueController
from moc_opt.sim.record import TaskOffset
from moc_opt.solvers.base import Solver
from moc_opt.solvers.faulty import Faulty, draw
from moc_opt.tasks import Trocar


class Objects:
    """Objects built from a validated scenario: robot, plant, references."""

    def __init__(self, scenario: Scenario, solver: Solver | None = None, *, realtime: bool = False) -> None:
        """Build and check everything before anything moves.

        Args:
            solver: asked in place of the one that the scenario names, which stays in the trace's `meta`.
            realtime: for the controller alone, whose plant is at the other end of a wire: none is built. A tick waits
                for an isolated solver at most half its period where there is no budget, and never while the process is
                replaced.

        Raises:
            MocOptError: the first thing that is wrong, in its own words; see `moc_opt.scenario.layout.lay_out` for the
                start and the path.
        """
        if solver is not None:
            check_solver(solver)
        self.scenario, self._given, self.realtime = scenario, solver, realtime
        start_seed, plant_seed, fault_seed = seeds_of(scenario)
        self.robot = scenario.robot.arm()
        check_engines(self.robot)
        if scenario.control.law == "moc":
            require_freedom(self.robot)
        layout = lay_out(scenario, self.robot, np.random.default_rng(start_seed))
        self.layout = layout
        self.q_start, self.registered, self.reference = layout.q, layout.registered, layout.reference
        self.duration_s = layout.duration_s
        self._fault_seed = fault_seed
        self.guide: Guide | None = None
        """The guide of the last controller's third level; None without one."""
        self._replayed_us = recorded_times(scenario)
        if not realtime:
            self._build_plant(plant_seed)

    def _build_plant(self, seed: int) -> None:
        """Put the plant at the start, where it truly holds the tool, and lay the true trocar."""
        scenario, entry = self.scenario, self.layout.trocar
        self.plant = Plant(self.robot.data, scenario.plant, seed=seed)
        if scenario.faults.bump_N > 0.0:  # an unknown link is found now, not in the middle of the run
            self.plant.push(scenario.faults.bump_link, np.zeros(3))
        self.plant.reset(self.q_start)
        self.offset = self._offset_of_touch(entry, scenario.trocar.depth_m)
        true = entry + self.offset.trocar + self.plant.mismatch.registration_error
        self.trocar = Trocar(true, *breathing(scenario))

    def _offset_of_touch(self, entry: Array, depth: float) -> TaskOffset:
        """Lay the task where the arm's own tip is; ``entry`` (3,) [m] is where its model puts the incision.

        The incision lies on the shaft as it truly stands, and the path begins at the true tip.
        """
        plant = self.plant
        if not (plant.mismatch.displaces or plant.settings.elastic):
            return TaskOffset()  # equal but for rounding
        shaft, tip = plant.tip - plant.wrist, self.robot.state(self.q_start).tip
        return TaskOffset(plant.tip - tip, plant.tip - depth * shaft / np.linalg.norm(shaft) - entry)

    def solver(self) -> Solver | None:
        """Make the solver of the scenario; None under DCAC."""
        if self.scenario.control.law != "moc":
            return None
        asked = self.scenario.solver
        solver = self._given or make_solver(asked.name, self.robot, **asked.settings)
        faults = self.scenario.faults
        if faults.solver == "none" or faults.solver == "hang":
            return solver
        return Faulty(solver, faults.solver, faults.solver_share, self._fault_seed)

    def controller(self) -> Controller:
        """Make the scenario's law and solver."""
        settings, times, solver = self.scenario.control, self._times(), self.solver()
        budget = settings.supervisor.budget_us
        if solver is not None:
            if self.scenario.faults.solver == "hang":
                budget = budget or self.scenario.deadline_us
            inside, wall = solver, budget if times is None else None
            if self.realtime and wall is None:
                wall = 0.5e6 * self.scenario.plant.period_s
            solver = isolated(inside, self.scenario, wall, self.realtime)
            if solver is not inside and times is None:
                budget = None  # the process keeps it, and an older answer in its place is not late
        watch = settings.supervisor.model_copy(update={"budget_us": budget})
        settings = settings.model_copy(update={"supervisor": watch})
        self.guide = None if self._guides is None else self._guides()
        return Controller(self.robot, settings, solver, self.scenario.plant.period_s, times, self.guide)

    def _times(self) -> Iterator[float] | None:
        """Solve times [us] that stand for the clock's, where the scenario replays some or a solver that hangs."""
        if self.scenario.faults.solver == "hang" and self.scenario.control.law == "moc":
            # Replayed times, not a clock: the same seed is late at the same ticks on any machine.
            budget = self.scenario.control.supervisor.budget_us or self.scenario.deadline_us
            return iter(np.where(self.fault_mask(), 10.0 * budget, 0.0))
        return None if self._replayed_us is None else itertools.cycle(self._replayed_us)

    @cached_property
    def _guides(self) -> Callable[[], Guide] | None:
        """Planned once, however many controllers are made."""
        return guides(self.scenario, self.robot, self.layout)

    def fault_mask(self) -> NDArray[np.bool_]:
        """Return at which ticks the solver's answer is replaced by a fault, (N,)."""
        faults, ticks = self.scenario.faults, self.ticks
        if faults.solver == "none" or self.scenario.control.law != "moc":
            return np.zeros(ticks, dtype=np.bool_)
        return draw(self._fault_seed, faults.solver_share, ticks)

    def adapter(self) -> LoggedController:
        """Make the controller as the closed loop calls it."""
        return ControllerAdapter(self.controller())

    def closed_loop(self, controller: TorqueController) -> ClosedLoop:
        """Make the loop of the plant and a controller behind the scenario's safety filter, without faults and trace."""
        safety_filter = make_safety_filter(self.robot, self.scenario)
        return ClosedLoop(self.plant, controller, safety_filter, make_stop(self.scenario))

    @property
    def ticks(self) -> int:
        """Number of ticks of the whole run."""
        return max(1, round(self.duration_s / self.scenario.plant.period_s))

    def times(self) -> Array:
        """Return the start of every tick [s]."""
        return self.scenario.plant.period_s * np.arange(self.ticks, dtype=np.float64)
