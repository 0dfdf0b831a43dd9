"""Compare solvers in closed loop: the same trials under DCAC and under MOC with each of them."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.comparison.statistics import Interval, StatisticsError, mean, relative_change
from moc_opt.comparison.trials import BASELINE, placed, variant
from moc_opt.errors import MocOptError, ScenarioError, SolverError, UnknownNameError, describe, shown
from moc_opt.inputs.files import LARGEST_INTEGER
from moc_opt.inputs.notebook import grid_html
from moc_opt.report.machine import busy
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import RunAway, Scenario, make_solver, run
from moc_opt.scenario.parts import check_solver
from moc_opt.solvers.base import Solver
from moc_opt.trace.ending import Ending
from moc_opt.trace.metrics import METRICS, summarize
from moc_opt.trace.trace import Trace

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure

Solvers = Sequence[str | Solver] | Mapping[str, str | Solver]
Row = dict[str, Any]

CHANGES = {"mu_mean": "gain", "tip_error_model_mean_mm": "tip_change", "rcm_error_model_mean_mm": "rcm_change"}
"""Metric -> name of its change against DCAC in `Comparison.summary` [percent]."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` found; a notebook shows its table.

    Attributes:
        rows: one mapping a run: solver, seed, ended, asked (ticks with a subproblem), then every metric; of a run
            that could not be made `ended` is "failed: " and why, and there is no metric.
        solvers: their names in the table, the baseline first.
        scenario: from which the trials were made.
        note: from where the trials start, and that the machine was busy where it was.
        complete: False where Ctrl-C ended it after some of the trials.
    """

    rows: Sequence[Mapping[str, Any]]
    solvers: Sequence[str]
    scenario: Scenario
    note: str = ""
    complete: bool = True

    def values(self, solver: str, metric: str) -> dict[int, float]:
        """Return seed -> value of a metric over those trials that the solver drove to their end.

        Raises:
            UnknownNameError: no such solver, or no run has such a metric.
        """
        if solver not in self.solvers:
            raise UnknownNameError("solver of this comparison", solver, self.solvers)
        if metric not in METRICS and not any(metric in row for row in self.rows):
            raise UnknownNameError("metric", metric, METRICS)
        mine = [row for row in self.rows if row["solver"] == solver and Ending.of(row["ended"]).whole]
        return {row["seed"]: float(row[metric]) for row in mine if metric in row}

    def mean(self, solver: str, metric: str) -> Interval | None:
        """Return the mean of a metric over the solver's whole trials, with its 95 % interval; None without any."""
        values = list(self.values(solver, metric).values())
        return mean(values) if values and np.isfinite(values).all() else None

    def change(self, solver: str, metric: str) -> Interval | None:
        """Return the change of a mean against DCAC [percent], on the trials that both drove to their end."""
        mine, theirs = self.values(solver, metric), self.values(BASELINE, metric)
        both = [seed for seed in mine if seed in theirs]
        try:
            return relative_change([mine[seed] for seed in both], [theirs[seed] for seed in both])
        except StatisticsError:
            return None  # no trial that both finished

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return solver -> counts, shares, medians of times, and means and changes as `Interval`."""
        return {name: self._of(name) for name in self.solvers}

    def _of(self, name: str) -> dict[str, Any]:
        rows = [row for row in self.rows if row["solver"] == name]
        asked = sum(row["asked"] for row in rows)
        found: dict[str, Any] = {
            "trials": sum(Ending.of(row["ended"]).whole for row in rows), "of": len(rows),
            "oscillated": sum(Ending.of(row["ended"]) is Ending.OSCILLATED for row in rows),
        }  # fmt: skip
        answered = [row for row in rows if row["asked"]]
        if answered and all("verified_solved" in row for row in answered):
            found["verified"] = 100.0 * sum(row["verified_solved"] for row in answered) / asked
            found["silently_wrong"] = sum(row["silently_wrong"] for row in answered)
        if answered:
            found |= {key: float(np.median([row[key] for row in answered])) for key in ("solve_p50_us", "solve_p99_us")}
        for metric, change in CHANGES.items():
            found[metric] = self.mean(name, metric)
            if name != BASELINE:
                found[change] = self.change(name, metric)
        return found

    @property
    def table(self) -> Table:
        """One row a solver: trials, what its claims are worth, its times, and what its answers do to the arm."""
        columns = [
            Column("solver", "solver"), Column("trials", "trials"), Column("verified", "verified", "%", digits=4),
            Column("silently_wrong", "silently wrong"), Column("solve_p50_us", "p50", "us"),
            Column("solve_p99_us", "p99", "us"), Column("mu_mean", "mu", "m^3"), Column("gain", "gain", "%"),
            Column("tip_error_model_mean_mm", "tip", "mm"), Column("rcm_error_model_mean_mm", "RCM", "mm"),
            Column("oscillated", "oscillated"),
        ]  # fmt: skip
        rows = []
        for name, found in self.summary().items():
            whole, of = found["trials"], found.pop("of")
            shown = {key: _words(value) if isinstance(value, Interval) else value for key, value in found.items()}
            rows.append({**shown, "solver": name, "trials": str(whole) if whole == of else f"{whole} of {of}"})
        used = [c for c in columns if c.key != "oscillated" or any(row["oscillated"] for row in rows)]
        caption = (
            "Means over the trials that came to their end, with 95 % intervals; gain: of the mean mu over that of DCAC "
            "with the same gains on the same trials; times: of the middle trial; tip and RCM by the robot's own "
            "kinematics."
        )
        named = "name" in self.scenario.model_fields_set
        title = self.scenario.name if named else self.scenario.task.path
        about = " ".join(filter(None, [caption, self.note, *self._failures()]))
        return Table(f"{title}: solvers on the same trials", used, rows, about)

    def _failures(self) -> list[str]:
        """One sentence a solver of which runs could not be made: how many, and why the first."""
        said = []
        for name in self.solvers:
            failed = [
                row["ended"] for row in self.rows if row["solver"] == name and Ending.of(row["ended"]) is Ending.FAILED
            ]
            if failed:
                said.append(f"{name} failed in {len(failed)}: {failed[0].partition(': ')[2]}.")
        return said

    def plot(self, metric: str = "mu_mean") -> Figure:
        """Draw a metric over the trials as one box a solver: a plotly figure.

        Raises:
            UnknownNameError: no run has such a metric.
        """
        from moc_opt.report.figures import box_plots

        samples = {name: list(self.values(name, metric).values()) for name in self.solvers}
        return box_plots({name: {"all trials": data} for name, data in samples.items() if data}, metric)

    def to_pandas(self) -> DataFrame:
        """Return a pandas.DataFrame with one row a run: solver, seed, ended, then every metric.

        Raises:
            ScenarioError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise ScenarioError("pandas is not installed: pip install 'moc-opt[dataframes]'") from error
        return pandas.DataFrame([dict(row) for row in self.rows])

    def save_rows(self, path: str | os.PathLike[str]) -> None:
        """Write one row a run as CSV: solver, seed, ended, then every metric.

        Raises:
            ScenarioError: the file cannot be written.
        """
        written = io.StringIO(newline="")
        table = csv.DictWriter(written, list(dict.fromkeys(key for row in self.rows for key in row)))
        table.writeheader()
        table.writerows(self.rows)
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            Path(path).write_text(written.getvalue(), encoding="utf-8", newline="")
        except OSError as error:
            raise ScenarioError(f"{path}: cannot be written: {error}") from error

    def __repr__(self) -> str:
        return self.table.to_text()

    def _repr_html_(self) -> str:
        """Show the table in a notebook."""
        table = self.table
        cells = [[cell.text for cell in table.cells(column)] for column in table.columns]
        headings = [f"{column.title} [{column.unit}]" if column.unit else column.title for column in table.columns]
        return grid_html(table.title, zip(*cells, strict=True), headings, table.caption)


def compare(
    solvers: Solvers, scenario: Scenario | str | os.PathLike[str] | None = None, trials: int = 15, *, seed: int = 0,
    random_start: bool = True, watch: Callable[[str], None] | None = None,
) -> Comparison:  # fmt: skip
    """Run every solver, and DCAC with the same gains, on the same trials.

    A solver that cannot be started, or that breaks a run off with an error, has rows that say so; the others go on.
    Ctrl-C leaves the trials that are done, once there is one.

    Args:
        solvers: names, or solvers made by `solvers.create` or of one's own; a mapping gives them names of their own.
        scenario: of every trial, or the path of its file; None: the default one.
        trials: how many; trial k has the seed ``seed + k``, which draws start, mismatch and noise.
        seed: of the first trial.
        random_start: whether pose and swivel are drawn too, in place of the scenario's `[start]`; False keeps that.
        watch: called with a few words before each run.

    Raises:
        UnknownNameError, SolverError: no such solver, no solver, or two of one name; before anything runs.
        ScenarioError: an argument is not usable, the scenario has no third level, or DCAC cannot run it.
    """
    base = Scenario() if scenario is None else Scenario.given(scenario)
    for argument, value, least in (("trials", trials, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= LARGEST_INTEGER:
            raise ScenarioError(f"{argument} = {shown(value)}: give an integer of {least} or more")
    if not isinstance(random_start, bool):
        raise ScenarioError(f"random_start = {shown(random_start)}: give True or False")
    if watch is not None and not callable(watch):
        raise ScenarioError(f"watch = {shown(watch)}: give a function of one text, or None")
    if base.control.law != "moc":
        raise ScenarioError("[control] law = 'dcac' asks no solver: take law = 'moc', DCAC is compared anyhow")
    chosen, note, rows = _named(solvers, base), f"{_starts(base, random_start)} {busy()}".strip(), list[Row]()
    start = {"pose": "random", "q_rad": None, "swivel": "random"} if random_start else {}
    done = 0
    try:
        for k in range(seed, seed + trials):
            rows += _trial(base, k, start, chosen, f"trial {k - seed + 1} of {trials}", watch, first=not rows)
            done += 1
    except KeyboardInterrupt:
        if not done:
            raise
        note = f"Interrupted: {done} of {trials} trials. {note}".strip()
    return Comparison(rows, list(chosen), base, note, done == trials)


def _trial(
    base: Scenario, seed: int, start: Mapping[str, Any], chosen: Mapping[str, str | Solver], where: str,
    watch: Callable[[str], None] | None, first: bool,
) -> list[Row]:  # fmt: skip
    """Run every solver on one trial; an error in laying out the first one is the scenario's, and is raised."""
    try:
        trial, baseline = placed(base.change(seed=seed, start=start)), None
    except MocOptError as error:
        if first:
            raise
        failed = f"{Ending.FAILED.value}: {describe(error)}"
        return [{"solver": name, "seed": seed, "ended": failed, "asked": 0} for name in chosen]
    rows = []
    for name, solver in chosen.items():
        if watch is not None:
            watch(f"{where}, {name}")
        row, trace = _row(trial, base, name, solver, baseline)
        rows.append({"solver": name, "seed": seed, **row})
        if name == BASELINE and Ending.of(row["ended"]).whole:
            baseline = trace
    return rows


def _row(
    trial: Scenario, base: Scenario, name: str, solver: str | Solver, baseline: Trace | None
) -> tuple[Row, Trace | None]:
    """Run one solver on a trial: how it ended, its ticks with a subproblem, its metrics; and its trace, if any."""
    named = solver if isinstance(solver, str) else None
    case = trial if named is None else variant(trial, named, _settings(base, named))
    try:
        trace = _run(case, None if isinstance(solver, str) else solver)
    except Exception as error:
        if name == BASELINE or isinstance(error, MemoryError):
            raise  # no solver is at fault
        return {"ended": f"{Ending.FAILED.value}: {describe(error)}", "asked": 0}, None
    found = {"ended": str(trace.meta["ended"]), "asked": _asked(trace)}
    same_length = baseline is not None and len(trace) == len(baseline)
    return found | summarize(trace, baseline if same_length else None), trace


def _starts(base: Scenario, random_start: bool) -> str:
    """From where the trials start, where that is not what the scenario says, or the same for all."""
    if not random_start:
        fixed = base.start.pose != "random" and base.start.swivel != "random"
        return "All trials start as the scenario's [start] says, from one pose." if fixed else ""
    said = base.start.model_fields_set & {"pose", "q_rad", "swivel"}
    text = "Starts are drawn at random: [start] is not used (`--keep-start`, random_start=False keep it)."
    return text if said else ""


def _settings(base: Scenario, name: str) -> Mapping[str, Any]:
    """Settings of the scenario's own solver, where that one is meant."""
    return base.solver.settings if name == base.solver.name else {}


def _run(case: Scenario, solver: Solver | None) -> Trace:
    try:
        return run(case, solver=solver)
    except RunAway as error:
        return error.trace


def _asked(trace: Trace) -> int:
    """Count the ticks at which there was a subproblem."""
    return int(np.count_nonzero(trace.status != "none")) if "status" in trace.columns else 0


def _named(solvers: Solvers, base: Scenario) -> dict[str, str | Solver]:
    """Name -> solver, the baseline first; every name is made once, so that a wrong one is found now."""
    if isinstance(solvers, str):
        raise SolverError(f"solvers = {solvers!r} is one text: give a list, [{solvers!r}]")
    if not isinstance(solvers, Mapping | Sequence):
        raise SolverError(f"solvers = {shown(solvers)}: give a list of names or solvers, such as ['exact', 'osqp']")
    pairs = solvers.items() if isinstance(solvers, Mapping) else [(_name(one), one) for one in solvers]
    robot, chosen = base.robot.arm(), dict[str, str | Solver]({BASELINE: BASELINE})
    for name, solver in pairs:
        if name == solver == BASELINE:
            continue  # it is compared anyhow
        if name in chosen:
            raise SolverError(
                f"two solvers are called {name!r}: name each once, or give a mapping, {{'one': ..., 'another': ...}}"
            )
        if isinstance(solver, str):
            make_solver(solver, robot, **_settings(base, solver))
        else:
            check_solver(solver)
        chosen[name] = solver
    if len(chosen) == 1:
        raise SolverError("no solver to compare: give one name or more, such as ['exact', 'osqp']")
    return chosen


def _name(solver: str | Solver) -> str:
    return solver if isinstance(solver, str) else str(getattr(solver, "name", type(solver).__name__))


def _words(found: Interval) -> str:
    if found.samples < 2:
        return f"{found.value:.3g}"
    return f"{found.value:.3g} [{found.low:.3g}, {found.high:.3g}]"
