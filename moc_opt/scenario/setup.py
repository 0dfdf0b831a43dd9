"""Run a scenario with the objects built from it, and collect the columns of its trace."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.control.called_tick import CalledTick
from moc_opt.control.interpreter import Interpreter
from moc_opt.errors import ScenarioError, TraceError, describe, shown
from moc_opt.inputs.files import as_path
from moc_opt.numerics.arrays import Array
from moc_opt.planning.follow import Follower
from moc_opt.planning.receding import Receding
from moc_opt.scenario import steps
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.derived import largest_mu, model_errors, residual_columns
from moc_opt.scenario.layout import described
from moc_opt.scenario.objects import Objects
from moc_opt.scenario.parts import make_safety_filter, make_stop
from moc_opt.scenario.python_tick import PythonTick
from moc_opt.scenario.rows import Timed, check_room
from moc_opt.scenario.yardstick import against_best
from moc_opt.sim.faults import Faults
from moc_opt.sim.log import Sink
from moc_opt.sim.loop import BLOCK, RunAway, simulate
from moc_opt.solvers.base import Solver
from moc_opt.trace.oscillation import judged_for_oscillation
from moc_opt.trace.trace import Trace
from moc_opt.trace.writer import TraceWriter


class Setup(Objects):
    """Objects built from a validated scenario: robot, plant, references; ``trace()`` runs it."""

    def trace(
        self, watch: Callable[[int], None] | None = None, to: str | os.PathLike[str] | None = None, block: int = BLOCK
    ) -> Trace:
        """Run, check the answers, and return the trace.

        Args:
            watch: called with the number of every tick before it.
            to: a Parquet file to which the trace is written during the run, ``block`` ticks at a time; the columns
                of the returned trace then stay in the file (`Trace.open`). None: the whole trace is kept in memory.
            block: see ``to``.

        Raises:
            MocOptError: the run does not fit into the memory or onto the disk; or the arm ran away, and the error
                holds the trace. If a run to a file ends by an exception, the file has the rows so far.
        """
        if watch is not None and not callable(watch):
            raise ScenarioError(f"watch = {shown(watch)}: give a function of a tick's number, or None")
        if to is not None:
            to = as_path(to, "trace", TraceError)
        if self.plant.time > 0.0:
            self.plant.reset(self.q_start)
        check_room(self.scenario, self.ticks, to)
        meta = {
            **described(self.scenario, self.robot), "deadline_us": self.scenario.deadline_us,
            "start_q_rad": self.q_start.tolist(),
        }  # fmt: skip
        if to is not None:
            # Absolute: a solver may leave the process in another working directory.
            return self._streamed(to.absolute(), meta, watch, block)
        found = self._simulate(watch, meta)
        trace = Trace({**found.columns, **self._row_by_row(found.columns)}, found.meta)
        trace = judged_for_oscillation(trace, self.robot.data.joint_names, self.robot.chain.prismatic)
        columns, told = self._yardsticks(trace)
        return trace.with_columns(**columns).with_meta(**told)

    def _simulate(
        self, watch: Callable[[int], None] | None, meta: Mapping[str, Any], sink: Sink | None = None, block: int = BLOCK
    ) -> Trace:
        period, wrong, ticks = self.scenario.plant.period_s, self.scenario.faults, self.ticks
        faults = Faults(wrong, self.robot.n, period, self._fault_seed)

        def trocar(t: Array) -> Array:
            return faults.slip(np.stack(self.trocar.at(t), axis=1), t)

        controller, safety_filter = self.adapter(), make_safety_filter(self.robot, self.scenario)
        around = faults if wrong.around_the_arm else None
        compiled = None
        if type(controller) is ControllerAdapter:
            controller = PythonTick(controller)
        if isinstance(controller, CalledTick):  # not where it is another process
            compiled = steps.compiled_steps(self.plant, controller, safety_filter, around)
        with Interpreter():  # restored after the run if a solver changed it
            found = simulate(
                self.plant, controller, Timed(lambda t: np.stack(self.reference.at(t), axis=1), period, ticks),
                Timed(trocar, period, ticks), Timed(lambda t: np.stack(self.registered.at(t), axis=1), period, ticks),
                safety_filter=safety_filter, faults=around, compiled=compiled,
                stop=make_stop(self.scenario), offset=self.offset, watch=watch, meta=meta, sink=sink, block=block,
            )  # fmt: skip
        guide, told = self.guide, dict[str, Any]()
        if isinstance(guide, Follower):
            told["course_mu_mean"] = guide.course_mu_mean
        if isinstance(guide, Receding | Follower) and guide.told:
            told["replans"] = guide.told
        return found.with_meta(**told)

    def _streamed(self, to: Path, meta: dict[str, Any], watch: Callable[[int], None] | None, block: int) -> Trace:
        """Return a run whose rows go to the disk as they come; judged block by block."""
        period, broken = self.scenario.plant.period_s, None
        with TraceWriter(to, {**meta, "period_s": period, "ticks_planned": self.ticks}) as writer:

            if writer.kept is not None:
                meta["earlier_run"] = f"one that had been killed is kept in {writer.kept}"

            def sink(first: int, columns: dict[str, NDArray[Any]]) -> None:
                writer.write(first, {**columns, **self._row_by_row(columns, first)})

            try:
                found = self._simulate(watch, meta, sink, block)
            except RunAway as error:
                found, broken = error.trace, error
            except BaseException as error:
                rows = writer.rows()
                if rows:
                    ended = f"interrupted: {describe(error)} (t = {rows * period:.3f} s)"
                    told = {"period_s": period, "ended": ended, "ticks": rows, "ticks_planned": self.ticks}
                    writer.finish({**told, **meta})
                    error.add_note(f"the first {rows * period:.3f} s of the run are in {to}")
                raise
            run = Trace.of_files(writer.columns(), found.meta)
            run = judged_for_oscillation(run, self.robot.data.joint_names, self.robot.chain.prismatic)
            yardsticks, told = self._yardsticks(run)
            writer.finish({**run.meta, **told}, yardsticks)
        trace = Trace.open(to)
        if broken is not None:
            raise RunAway(str(broken), trace) from broken
        return trace

    def _row_by_row(self, columns: Mapping[str, NDArray[Any]], first: int = 0) -> dict[str, NDArray[Any]]:
        """Return the columns that follow from the same rows: faults injected, the robot's errors, mu, residuals."""
        found: dict[str, NDArray[Any]] = {}
        rows = len(columns["t_s"])
        if self.scenario.faults.solver != "none":
            found["injected"] = self.fault_mask()[first : first + rows]
        found |= model_errors(columns, self.robot, self.plant, self.offset)
        found["mu"] = self.robot.mu_along(columns["q_rad"])
        return found | (residual_columns(columns) if self.scenario.judge else {})

    def _yardsticks(self, trace: Trace) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the references of mu: the largest at single ticks, and best courses; columns, and meta."""
        bound, method = largest_mu(trace.q_rad, self.robot, self.scenario.bound_samples)
        best, told = against_best(self.scenario, trace) if self.scenario.best_courses else ({}, {})
        return {"mu_bound": bound, **best}, {**method, **told}


def run(
    scenario: Scenario | str | os.PathLike[str], watch: Callable[[int], None] | None = None,
    to: str | os.PathLike[str] | None = None, *, solver: Solver | None = None,
) -> Trace:  # fmt: skip
    """Run one scenario, or that of a file.

    Args:
        scenario: what to run, or the path of its file.
        watch: called with the number of every tick before it.
        to: a Parquet file that the trace goes into while it grows, for a run larger than the memory.
        solver: in place of the one that the scenario names.

    Returns:
        one row a tick; ``meta["ended"]`` says how it ended.

    Raises:
        MocOptError: the scenario is not usable (raised before the run), or the arm ran away.

    Example:
        >>> trace = mo.run(mo.Scenario(duration_s=0.1, bound_samples=0), solver=mo.solvers.create("exact"))
        >>> trace.x_rad_per_s.shape, bool((trace.status == "solved").all())
        ((50, 7), True)
    """
    return Setup(Scenario.given(scenario), solver).trace(watch, to)
