"""Compare solvers and DCAC (the control law without level 3) in closed loop, on the same trials (``mo.compare``)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.errors import MocOptError, ScenarioError, SolverError, UnknownNameError, describe, shown
from moc_opt.figures.notation import Mark
from moc_opt.inputs.files import write_whole
from moc_opt.inputs.names import RULE, is_name
from moc_opt.inputs.settings import LARGEST_INTEGER
from moc_opt.report.console import busy
from moc_opt.report.run_table import ANOTHER_PROBLEM, VERDICTS, answers_another_problem
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, make_solver
from moc_opt.solvers.base import Solver
from moc_opt.solvers.registry import check_solver
from moc_opt.study.results import ERRORS, FRAMES, TITLES, Results, change_name
from moc_opt.study.show import columns, intervals_picture
from moc_opt.study.statistics import LEAST_TRIALS, too_few
from moc_opt.study.trials import BASELINE, Trial, placed, run_and_trace
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import METRICS

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure

Solvers = Sequence[str | Solver] | Mapping[str, str | Solver]

METRICS_SHOWN = ("mu_mean", *(name for frame in ("registered", "model") for name in ERRORS if frame in name))
CHANGES = {change_name(metric): f"{TITLES.get(metric, 'mu')}: change" for metric in METRICS_SHOWN}
"""Column headings of the changes against DCAC, by the key of the column."""
COLUMNS = [
    Column("solver", "solver"), Column("trials", "trials"), Column("verified", "verified", "%", ".4g"),
    Column("silently_wrong", "silently wrong"),
    Column("solve_p50_us", "p50", "us"), Column("solve_p99_us", "p99", "us"),
    *(Column(name, heading, "%") for name, heading in CHANGES.items()),
    *columns(*METRICS_SHOWN), Column("oscillated", "oscillated"),
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` found.

    Attributes:
        rows: one mapping per run, with solver, seed, ended, error, asked (number of subproblems) and every metric.
        solvers: the names in the table; the first is the baseline, "dcac".
        scenario: the scenario of the trials.
        note: remarks for the table's caption, for example that the machine was busy.
        complete: False if Ctrl-C ended the comparison.
    """

    rows: Sequence[Mapping[str, Any]]
    solvers: Sequence[str]
    scenario: Scenario
    note: str = ""
    complete: bool = True

    @cached_property
    def _results(self) -> Results:
        return Results(
            {**row, "controller": row["solver"], "trial": row["seed"], "whole": Ending.of(row["ended"]).whole}
            for row in self.rows
        )

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return each solver's means, changes, times, and numbers of verified and wrong answers."""
        return {
            name: self._results.figures(name, METRICS_SHOWN, METRICS_SHOWN) | self._answers(name)
            for name in self.solvers
        }

    def _answers(self, name: str) -> dict[str, Any]:
        rows = list(self._results.where(solver=name))
        found: dict[str, Any] = {"oscillated": sum(Ending.of(row["ended"]) is Ending.OSCILLATED for row in rows)}
        asked = [row for row in rows if row.get("asked")]
        if asked and all("verified_solved" in row for row in asked):
            ticks, verified, wrong = (
                sum(row[key] for row in asked) for key in ("asked", "verified_solved", "silently_wrong")
            )
            found |= {"verified": 100.0 * verified / ticks, "silently_wrong": wrong}
        if asked:
            found |= {key: float(np.median([row[key] for row in asked])) for key in ("solve_p50_us", "solve_p99_us")}
        return found

    @property
    def table(self) -> Table:
        """One row per solver: trials, answers, times, and the arm's mu and errors."""
        rows, failures = [], self.failures
        for name, found in self.summary().items():
            trials = f"{found['whole']}" + f" of {found['trials']}" * (found["whole"] < found["trials"])
            marked = Mark("!", name, "bad") if failures[name] else name
            rows.append({**found, **_cells(found), "solver": marked, "trials": trials})
        optional = {"oscillated", *CHANGES}
        known = [column for column in COLUMNS if column.key not in optional or any(row.get(column.key) for row in rows)]
        unjudged = any(row.get("asked") and "verified_solved" not in row for row in self.rows)
        other = ANOTHER_PROBLEM if unjudged and self.scenario.judge else ""
        named = "name" in self.scenario.model_fields_set
        title = self.scenario.name if named else self.scenario.task.path
        failed = [*chain.from_iterable(failures.values())]
        said = ["!:" if failed else "", *failed, *self._legend(rows), other]
        said.insert(len(said) if self.complete else 0, self.note)
        return Table(f"{title}: solvers on the same trials", known, rows, " ".join(filter(None, said)))

    @property
    def failures(self) -> dict[str, list[str]]:
        """`Results.failures` of each solver."""
        return {name: self._results.failures(name) for name in self.solvers}

    def _legend(self, rows: Sequence[Mapping[str, Any]]) -> list[str]:
        """Return the sentences that explain what these rows of a table show."""
        keys = {key for row in rows for key, value in row.items() if value is not None}
        means, changes = (" ".join(str(row.get(key)) for row in rows for key in of) for of in (METRICS_SHOWN, CHANGES))
        sentences = {
            "Means are over completed trials.": any(" of " in row["trials"] for row in rows),
            f"{LEAST_TRIALS} trials or more give 95 % intervals, and changes relative to dcac.": "[" not in means,
            "In brackets: 95 % intervals.": "[" in means,
            "Changes are relative to dcac (the control law without level 3, with equal gains). A change is the ratio "
            "of the means, minus 1.": "[" in changes,
            "?: undecided, because the change and the mean of the trials' changes differ in sign, or because only one "
            "of their two intervals contains 0.": "?" in changes,
            "Verified: share of answers that a check found optimal. Silently wrong: number of wrong answers reported "
            "as optimal.": "verified" in keys,
            "p50, p99: median and 99th percentile of a trial's solve times, then the median of these over the trials.":
                "solve_p50_us" in keys,
            "The times of the solver exact do not include the call from Python.": "exact" in self.solvers,
            FRAMES: bool(keys & {*ERRORS}),
        }  # fmt: skip
        return [sentence for sentence, applies in sentences.items() if applies]

    def plot(self, metric: str = "mu_mean") -> Figure:
        """Draw each solver's mean of a metric with a 95 % interval. Raise an UnknownNameError for an unknown metric."""
        if metric not in METRICS and not any(metric in row for row in self.rows):
            raise UnknownNameError("metric", metric, METRICS, "moc-opt metrics")
        means = {name: mean for name in self.solvers if (mean := self._results.mean(metric, name))}
        unit = METRICS[metric].unit if metric in METRICS else "1"
        said = metric if unit == "1" or metric.endswith(f"_{unit}") else f"{metric} [{unit}]"
        return intervals_picture({name: (one.low, one.value, one.high) for name, one in means.items()}, said, {})

    def to_pandas(self) -> DataFrame:
        """Return a pandas.DataFrame with one row per run. Raise a ScenarioError if pandas is missing."""
        try:
            import pandas
        except ImportError as error:
            raise ScenarioError("pandas is not installed: pip install '.[dataframes]' in the clone") from error
        return pandas.DataFrame([dict(row) for row in self.rows])

    def save_rows(self, path: str | os.PathLike[str]) -> None:
        """Write the runs as CSV. Raise a ScenarioError if the file cannot be written."""
        write_whole(path, Results(self.rows).frame.write_csv(), "table of runs", ScenarioError)

    def __repr__(self) -> str:
        return repr(self.table)


def _cells(found: Mapping[str, Any]) -> dict[str, str | None]:
    """Return means and changes as texts, with their intervals if there are enough trials."""
    cells = dict[str, str | None]()
    for name in (name for name in (*METRICS_SHOWN, *CHANGES) if name in found):
        few, sign = too_few(found["compared" if name in CHANGES else "whole"]), "+" * (name in CHANGES)
        value, low, high = (f"{found[name + end]:{sign}.3g}" for end in ("", "_low", "_high"))
        whole = f"{value} [{low}, {high}]" + "?" * bool(found.get(f"{name}_undecided"))
        cells[name] = whole if not few else None if name in CHANGES else value
    return cells


def compare(
    solvers: Solvers, scenario: Scenario | str | os.PathLike[str] | None = None, trials: int = 15, *, seed: int = 0,
    watch: Callable[[str], object] = lambda words: None,
) -> Comparison:  # fmt: skip
    """Run every solver, and DCAC with the same gains, on the same trials.

    The row of a failed run holds the reason of the failure. After Ctrl-C, only finished trials are returned.

    Args:
        solvers: names or solver objects. A mapping's keys are the solvers' names in the table.
        scenario: a scenario, or the path of its file; None: the default scenario.
        trials: number of trials. Trial k has the seed ``seed + k``.
        seed: the seed of the first trial.
        watch: called before each run with a text such as "trial 1 of 15, osqp".

    Raises:
        UnknownNameError, SolverError: a solver is unknown, none is given, or two share a name.
        ScenarioError: an argument is not usable, the scenario has no third level, or DCAC cannot run it.
    """
    base = Scenario() if scenario is None else Scenario.load(scenario)
    for argument, value, least in (("trials", trials, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= LARGEST_INTEGER // 2:
            raise ScenarioError(f"{argument} = {shown(value)}: give an integer from {least} to 2^62 - 1")
    if base.control.law != "moc":
        raise ScenarioError("[control] law = 'dcac' has no solver: use law = 'moc'; DCAC is compared in any case")
    chosen, rows, done = _named(solvers, base), list[Mapping[str, Any]](), 0
    drawn = {"pose": "random", "q_rad": None, "swivel": "random"}
    unused = "Starts are drawn at random: [start] is not used." if base.start.model_fields_set & {*drawn} else ""
    note, complete = f"{unused} {busy()}".strip(), True
    try:
        for done in range(trials):
            case = base.change(seed=seed + done, start=drawn)
            try:
                case = placed(case)
            except MocOptError as error:
                if not rows:
                    raise  # if even the first trial has no start, the scenario is at fault
                rows += [Trial(case, name, tags={"solver": name}).failed(describe(error)).row for name in chosen]
                continue
            rows += _trial(case, chosen, f"trial {done + 1} of {trials}", watch)
    except KeyboardInterrupt:
        if not done:
            raise
        note, complete = f"Interrupted: {done} of {trials} trials. {note}".strip(), False
    return Comparison(rows, list(chosen), base, note, complete)


def _trial(
    case: Scenario, chosen: Mapping[str, str | Solver], which: str, watch: Callable[[str], object]
) -> list[Mapping[str, Any]]:
    baseline, rows = None, list[Mapping[str, Any]]()
    for name, solver in chosen.items():
        watch(f"{which}, {name}")
        asked = Trial(case, name, _settings(case, solver), {"solver": name}, timed=True, solver=solver)
        trace = None
        try:
            run, trace = run_and_trace(asked, baseline)
        except Exception as error:
            if name == BASELINE or isinstance(error, MemoryError):
                raise  # the solver did not cause this error
            run = asked.failed(describe(error))
        unjudged = trace is not None and answers_another_problem(trace)
        rows.append({key: value for key, value in run.row.items() if not unjudged or key not in VERDICTS})
        if name == BASELINE and run.row["whole"]:
            baseline = trace
    return rows


def _settings(base: Scenario, solver: str | Solver) -> Mapping[str, Any]:
    return base.solver.settings if solver == base.solver.name else {}


def _named(solvers: Solvers, base: Scenario) -> dict[str, str | Solver]:
    """Return the solvers by name, and build them once to show errors early."""
    if isinstance(solvers, str) or not isinstance(solvers, Mapping | Sequence):
        raise SolverError(f"solvers = {shown(solvers)}: give a list of names or solvers, such as ['exact', 'osqp']")
    named: Iterable[tuple[Any, str | Solver]] = (
        solvers.items() if isinstance(solvers, Mapping) else [(getattr(one, "name", one), one) for one in solvers]
    )
    robot, chosen = base.robot.arm(), dict[str, str | Solver]({BASELINE: BASELINE})
    for name, solver in named:
        if not isinstance(solver, str):
            check_solver(solver)
        if not is_name(name):
            raise SolverError(f"{shown(name)} cannot name a solver in the table: {RULE}")
        if name == solver == BASELINE:
            continue  # the baseline is always compared
        if name in chosen:
            raise SolverError(
                f"two solvers are called {name!r}: name each once, or give a mapping, {{'one': ..., 'another': ...}}"
            )
        if isinstance(solver, str):
            make_solver(solver, robot, **_settings(base, solver))
        chosen[name] = solver
    if len(chosen) == 1:
        raise SolverError("no solver to compare: give one name or more, such as ['exact', 'osqp']")
    return chosen
