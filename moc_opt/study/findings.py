"""The results of a comparison of solvers: means, changes against DCAC, tables, a plot."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.errors import ScenarioError, UnknownNameError
from moc_opt.inputs.files import write_whole
from moc_opt.report.run_table import ANOTHER_PROBLEM
from moc_opt.report.tables import Column, Table, as_text, terminal_width
from moc_opt.scenario import Scenario
from moc_opt.study.statistics import Change, Interval, StatisticsError, mean, relative_changes, too_few
from moc_opt.study.trials import BASELINE
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import METRICS

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure
    from rich.table import Table as RichTable

CHANGES = {
    "mu_mean": "gain", "tip_error_model_mean_mm": "tip_change", "tip_error_registered_mean_mm": "tip_patient_change",
    "rcm_error_model_mean_mm": "rcm_change", "rcm_error_registered_mean_mm": "rcm_patient_change",
}  # fmt: skip
"""Metric -> name of its change against DCAC in `Comparison.summary` [percent]; errors in both frames."""

FRAMES = (
    "tip and RCM by the robot's own kinematics, what a controller can answer for, and (patient) in the frame "
    "registered at the start, what the patient gets"
)
SOLVER, TRIALS, OSCILLATED = (Column(name, name) for name in ("solver", "trials", "oscillated"))
VERIFIED, WRONG = Column("verified", "verified", "%", digits=4), Column("silently_wrong", "silently wrong")
TIMES = (Column("solve_p50_us", "p50", "us"), Column("solve_p99_us", "p99", "us"))
MU, TIP, RCM = (
    Column(metric, title, unit)
    for metric, title, unit in (
        ("mu_mean", "mu", "m^3"), ("tip_error_model_mean_mm", "tip", "mm"), ("rcm_error_model_mean_mm", "RCM", "mm"),
    )
)  # fmt: skip
PATIENT = (
    Column("tip_error_registered_mean_mm", "patient tip", "mm"),
    Column("rcm_error_registered_mean_mm", "patient RCM", "mm"),
)
CHANGED = tuple(
    Column(key, title, "%", format="+.1f", help="change of the mean against DCAC's")
    for key, title in zip(
        CHANGES.values(), ("gain", "tip change", "patient tip change", "RCM change", "patient RCM change"), strict=True
    )
)


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` found; a notebook shows its table.

    Attributes:
        rows: one mapping a run: solver, seed, ended, asked (ticks with a subproblem), then every metric; of a run
            that could not be made `ended` is "failed: " and why, and there is no metric.
        solvers: their names in the table, the baseline first.
        scenario: from which the trials were made.
        note: where the trials start, and a remark if the machine was busy.
        complete: False where Ctrl-C ended it after some of the trials.

    Example:
        >>> found = mo.compare(["exact"], mo.Scenario(duration_s=0.05, bound_samples=0), trials=2)
        >>> found.solvers, found.summary()["exact"]["verified"], sorted(found.values("exact", "mu_mean"))
        (['dcac', 'exact'], 100.0, [0, 1])
        >>> gain = found.change("exact", "mu_mean")  # [percent], by both means, with 95 % intervals
        >>> gain.ratio.low <= gain.ratio.value <= gain.ratio.high, found.mean("dcac", "mu_mean").samples
        (True, 2)
        >>> found.table.title, len(found.tables(width=80)), found.to_pandas().shape[0]
        ('circle: solvers on the same trials', 2, 4)
        >>> [box.name for box in found.plot("tip_error_max_mm").data]
        ['dcac', 'exact']
        >>> found.save_rows("rows.csv")
    """

    rows: Sequence[Mapping[str, Any]]
    solvers: Sequence[str]
    scenario: Scenario
    note: str = ""
    complete: bool = True

    def values(self, solver: str, metric: str) -> dict[int, float]:
        """Return seed -> value of a metric, over the trials that the solver completed.

        Raises:
            UnknownNameError: no such solver, or no run has such a metric.
        """
        if solver not in self.solvers:
            raise UnknownNameError("solver of this comparison", solver, self.solvers)
        if metric not in METRICS and not any(metric in row for row in self.rows):
            raise UnknownNameError("metric", metric, METRICS, "moc-opt metrics")
        mine = [row for row in self.rows if row["solver"] == solver and Ending.of(row["ended"]).whole]
        return {row["seed"]: float(row[metric]) for row in mine if metric in row}

    def mean(self, solver: str, metric: str) -> Interval | None:
        """Return the mean of a metric over the solver's whole trials, with its 95 % interval; None without any.

        Raises:
            UnknownNameError: as for `values`.
        """
        values = list(self.values(solver, metric).values())
        return mean(values) if values and np.isfinite(values).all() else None

    def change(self, solver: str, metric: str) -> Change | None:
        """Return the change against DCAC [percent] by both means, on the trials that both completed; or None.

        Raises:
            UnknownNameError: as for `values`.
        """
        mine, theirs = self.values(solver, metric), self.values(BASELINE, metric)
        both = [seed for seed in mine if seed in theirs]
        try:
            return relative_changes([mine[seed] for seed in both], [theirs[seed] for seed in both])
        except StatisticsError:
            return None  # no trial that both finished

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return solver -> counts, shares, medians of times, means as `Interval` and changes as `Change`."""
        return {name: dict(found) for name, found in self._summary.items()}

    @cached_property
    def _summary(self) -> dict[str, dict[str, Any]]:
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
        """One row per solver: trials, claims and verified answers, times, and the effect on the arm."""
        columns = [SOLVER, TRIALS, VERIFIED, WRONG, *TIMES, *CHANGED, MU, TIP, PATIENT[0], RCM, PATIENT[1], OSCILLATED]
        return self._table(columns, _words)

    def tables(self, width: int) -> list[RichTable]:
        """Draw `table` for a terminal of this width [characters]; if it is too narrow, means and intervals are split.

        A table that is still too wide loses its last columns; `to_pandas` and `save_rows` have all.
        """
        return [self.table.to_rich(width)]

    def _table(self, columns: Sequence[Column], write: Callable[[str, Interval], Any]) -> Table:
        rows, remarks, lacking = [], [], dict[str, list[str]]()
        for name, found in self.summary().items():
            whole, of = found["trials"], found.pop("of")
            changes = {key: value for key in CHANGES.values() if isinstance(value := found.pop(key, None), Change)}
            few = [words for change in changes.values() if (words := too_few(change.ratio.samples))]
            if few:
                lacking.setdefault(few[0], []).append(name)
            else:
                found |= {key: change.ratio for key, change in changes.items()}
                remarks += [
                    f"{name}, {column.title} [%]: {changes[column.key]}."
                    for column in CHANGED
                    if column.key in changes and changes[column.key].undecided
                ]
            shown = {key: write(key, value) if isinstance(value, Interval) else value for key, value in found.items()}
            rows.append({**shown, "solver": name, "trials": str(whole) if whole == of else f"{whole} of {of}"})
        used = [
            c for c in columns
            if (c is not OSCILLATED or any(row["oscillated"] for row in rows))
            and (c not in CHANGED or any(c.key in row for row in rows))
        ]  # fmt: skip
        remarks += [f"{', '.join(names)} against DCAC: {words}." for words, names in lacking.items()]
        told = "gain and changes: of the mean over that of DCAC with the same gains on the same trials; "
        caption = (
            f"Means over the trials that came to their end, with 95 % intervals; {told if CHANGED[0] in used else ''}"
            f"times: of the middle trial; {FRAMES}."
        )
        caption = " ".join([caption, *remarks])
        named = "name" in self.scenario.model_fields_set
        title = self.scenario.name if named else self.scenario.task.path
        unjudged = any(row["asked"] and "verified_solved" not in row for row in self.rows)
        other = ANOTHER_PROBLEM if unjudged and self.scenario.judge else ""
        about = " ".join(filter(None, [caption, other, self.note, *self._failures()]))
        return Table(f"{title}: solvers on the same trials", used, rows, about)

    def _failures(self) -> list[str]:
        """Return one sentence a solver of which runs could not be made: how many, and why the first."""
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
        from moc_opt.figures import box_plots

        samples = {name: list(self.values(name, metric).values()) for name in self.solvers}
        unit = METRICS[metric].unit if metric in METRICS else "1"
        said = metric if unit == "1" or metric.endswith(f"_{unit}") else f"{metric} [{unit}]"
        return box_plots({name: {"all trials": data} for name, data in samples.items() if data}, said)

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
        write_whole(path, written.getvalue(), "table of runs", ScenarioError)

    def __repr__(self) -> str:
        return as_text(self.tables(width := terminal_width()), width)

    def _repr_html_(self) -> str:
        """Show the table in a notebook."""
        return self.table._repr_html_()


def _words(key: str, found: Interval) -> str:
    value = _number(key, found.value)
    return value if found.samples < 2 else f"{value} {_limits(key, found)}"


def _limits(key: str, found: Interval) -> str | None:
    return None if found.samples < 2 else f"[{_number(key, found.low)}, {_number(key, found.high)}]"


def _number(key: str, value: float) -> str:
    """Write a change with tenths below ten percent, anything else with three digits."""
    if key in CHANGES.values():
        return f"{value:.1f}" if abs(value) < 10.0 else f"{value:.0f}"
    return f"{value:.3g}"
