"""Run a scenario with the objects built from it, and collect the columns of its trace."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import ScenarioError, describe, shown
from moc_opt.planning.follow import Follower
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.derived import largest_mu, model_errors, residual_columns
from moc_opt.scenario.layout import described
from moc_opt.scenario.objects import Objects
from moc_opt.scenario.parts import make_safety_filter, make_stop
from moc_opt.scenario.yardstick import against_best
from moc_opt.sim.faults import Faults
from moc_opt.sim.loop import simulate
from moc_opt.sim.record import Columns, RunAway
from moc_opt.solvers.base import Solver
from moc_opt.trace.file import new_file
from moc_opt.trace.oscillation import judged_for_oscillation
from moc_opt.trace.trace import Trace


class Setup(Objects):
    """Objects built from a validated scenario: robot, plant, references; ``trace()`` runs it."""

    def trace(
        self, watch: Callable[[int], None] | None = None, to: str | os.PathLike[str] | None = None
    ) -> Trace:
        """Run, check the answers, and return the trace.

        Args:
            watch: called with the number of every tick before it.
            to: a Parquet file that the trace is saved in at the end; if the run ends by an exception, the rows so far.

        Raises:
            MocOptError: the arm ran away, and the error holds the trace; or the trace cannot be saved there.
        """
        if watch is not None and not callable(watch):
            raise ScenarioError(f"watch = {shown(watch)}: give a function of a tick's number, or None")
        # Absolute: a solver may leave the process in another working directory.
        file = None if to is None else new_file(to).absolute()
        if self.plant.time > 0.0:
            self.plant.reset(self.q_start)
        meta = {
            **described(self.scenario, self.robot), "deadline_us": self.scenario.deadline_us,
            "start_q_rad": self.q_start.tolist(),
        }  # fmt: skip
        rows: Columns = {}
        broken = None
        try:
            try:
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
        wrong, times = self.scenario.faults, self.times()
        faults = Faults(wrong, self.robot.n, self.scenario.plant.period_s, self._fault_seed)
        found = simulate(
            self.plant, self.adapter(), np.stack(self.reference.at(times), axis=1),
            faults.slip(np.stack(self.trocar.at(times), axis=1), times), np.stack(self.registered.at(times), axis=1),
            safety_filter=make_safety_filter(self.robot, self.scenario),
            faults=faults if wrong.around_the_arm else None, stop=make_stop(self.scenario), offset=self.offset,
            watch=watch, meta=meta, rescue=rescue,
        )  # fmt: skip
        guide, told = self.guide, dict[str, Any]()
        if isinstance(guide, Follower) and guide.course_mu_mean is not None:
            told["course_mu_mean"] = guide.course_mu_mean
        if isinstance(guide, Follower) and guide.told:
            told["replans"] = guide.told
        return found.with_meta(**told)

    def _judged(self, found: Trace) -> Trace:
        trace = found.with_columns(**self._row_by_row(found.columns))
        trace = judged_for_oscillation(trace, self.robot.data.joint_names, self.robot.chain.prismatic)
        bound, method = largest_mu(trace.q_rad, self.robot, self.scenario.bound_samples)
        best, told = against_best(self.scenario, trace) if self.scenario.best_courses else ({}, {})
        return trace.with_columns(mu_bound=bound, **best).with_meta(**method, **told)

    def _save_rest(self, rows: Columns, meta: Mapping[str, Any], file: Path, error: BaseException) -> None:
        """Save the rows of a run that an exception ended, and let the exception say where they are."""
        ticks, period_s = len(rows["t_s"]), self.scenario.plant.period_s
        ended = f"interrupted: {describe(error)} (t = {ticks * period_s:.3f} s)"
        told = {"period_s": period_s, "ended": ended, "ticks": ticks, "ticks_planned": self.ticks}
        Trace({**rows, **self._row_by_row(rows)}, {**told, **meta}).save(file)
        error.add_note(f"the first {ticks * period_s:.3f} s of the run are in {file}")

    def _row_by_row(self, columns: Mapping[str, NDArray[Any]]) -> Columns:
        """Return the columns that follow from the same rows: faults injected, the robot's errors, mu, residuals."""
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
    """Run one scenario, or that of a file.

    Args:
        scenario: what to run, or the path of its file.
        watch: called with the number of every tick before it.
        to: a Parquet file that the trace is saved in; the rows so far if an exception (Ctrl-C) ends the run.
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
