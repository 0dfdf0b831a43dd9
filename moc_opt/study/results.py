"""The rows of a study, and means and changes over its runs."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import polars as pl

from moc_opt.errors import StudyError
from moc_opt.inputs.files import plain, write_whole
from moc_opt.study.statistics import Change, Interval, StatisticsError, mean, relative_changes
from moc_opt.study.trials import BASELINE

ERRORS = (
    "tip_error_model_mean_mm", "tip_error_registered_mean_mm", "tip_error_mean_mm",
    "rcm_error_model_mean_mm", "rcm_error_registered_mean_mm", "rcm_error_mean_mm",
)  # fmt: skip
PHASES = ("settled", "travelling")
"""Prefixes of metrics. "travelling": while the elbow moves to its optimum; "settled": after its arrival."""
TITLES = {
    name: f"{part}, {frame}"
    for name, (part, frame) in zip(ERRORS, product(("tip", "RCM"), ("model", "registered", "base")), strict=True)
}
FRAMES = (
    "Model: the error computed with the robot's kinematic model. The controller can correct only this error. "
    "Registered: the error relative to the points touched at the start. This error matters to the patient."
)
BASE_FRAME = "Base: the error in the base frame (absolute accuracy)."


def change_name(metric: str) -> str:
    """Return the name of a metric's change, such as mu_gain_percent."""
    if metric == "mu_mean":
        return "mu_gain_percent"
    return metric.removesuffix("_Nm_per_s").removesuffix("_mm").removesuffix("_N").removesuffix("_mean") + (
        "_change_percent"
    )


class Results:
    """Rows of a study with ``trial``, ``controller``, ``ended``, ``whole`` (completed), ``error`` and metrics."""

    def __init__(self, rows: Iterable[Mapping[str, Any]] = ()) -> None:
        self._rows: list[dict[str, Any]] = [dict(row) for row in rows]

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self._rows)

    def add(self, *rows: Mapping[str, Any]) -> None:
        """Append rows."""
        self._rows += [dict(row) for row in rows]

    def where(self, **keys: Any) -> Results:
        """Return the rows that have these values in these columns."""
        return Results(row for row in self._rows if all(row.get(name) == value for name, value in keys.items()))

    def shared(self) -> Results:
        """Return the rows of trials that every controller ran."""
        ran = [{row["trial"] for row in self.where(controller=name)} for name in self.names()]
        return Results(row for row in self._rows if all(row["trial"] in trials for trials in ran))

    def names(self, column: str = "controller") -> list[Any]:
        """Return the distinct values of a column in order, without None."""
        return [name for name in dict.fromkeys(row.get(column) for row in self._rows) if name is not None]

    def values(self, metric: str, controller: str) -> dict[Any, float]:
        """Return the metric's value per trial, for the controller's completed runs."""
        mine = (row for row in self._rows if row.get("controller") == controller and row.get("whole"))
        return {row["trial"]: float(row[metric]) for row in mine if row.get(metric) is not None}

    def mean(self, metric: str, controller: str) -> Interval | None:
        """Return the mean over the controller's completed runs, or None if there is none."""
        try:
            return mean(list(self.values(metric, controller).values()))
        except StatisticsError:
            return None

    def pairs(self, metric: str, controller: str, baseline: str = BASELINE) -> tuple[list[float], list[float]]:
        """Return the values of both controllers, on the trials that both completed.

        For a metric of a phase, trials are weighted: both values of a trial are multiplied by the number of ticks that
        ``controller`` spent in the phase.
        """
        mine, theirs = self.values(metric, controller), self.values(metric, baseline)
        both = [trial for trial in mine if trial in theirs]
        phase = next((phase for phase in PHASES if metric.startswith(f"{phase}_")), None)
        ticks = self.values(f"{phase}_ticks", controller) if phase else dict.fromkeys(both, 1.0)
        return [mine[trial] * ticks[trial] for trial in both], [theirs[trial] * ticks[trial] for trial in both]

    def change(self, metric: str, controller: str, baseline: str = BASELINE) -> Change | None:
        """Return the change against the baseline [percent]. None if no trial is common or the baseline's mean is 0."""
        try:
            return relative_changes(*self.pairs(metric, controller, baseline))
        except StatisticsError:
            return None

    def figures(
        self, controller: str, means: Sequence[str] = (), changes: Sequence[str] = (), baseline: str = BASELINE
    ) -> dict[str, Any]:
        """Return a controller's counts, means and changes, for a summary."""
        mine = [row for row in self._rows if row.get("controller") == controller]
        found: dict[str, Any] = {
            "trials": len(mine), "whole": sum(bool(row.get("whole")) for row in mine),
            "compared": len(self.pairs("mu_mean", controller, baseline)[0]),
        }  # fmt: skip
        for metric in means:
            if (interval := self.mean(metric, controller)) is not None:
                found |= interval.entries(metric)
        for metric in changes if controller != baseline else ():
            if (change := self.change(metric, controller, baseline)) is not None:
                found |= change.entries(change_name(metric))
        errors = [row["error"] for row in mine if row.get("error")]
        raised = [f"{row['trial']}, {row['raised']}" for row in mine if row.get("raised")]
        return {**found, **({"reason": errors[0]} if errors else {}), **({"trouble": raised[0]} if raised else {})}

    def failed(self) -> list[Mapping[str, Any]]:
        """Return the rows that have an error."""
        return [row for row in self._rows if row.get("error")]

    def failures(self, controller: str) -> list[str]:
        """Return sentences on trials that the controller did not complete, and on its replaced answers."""
        mine, found = list(self.where(controller=controller)), list[str]()
        if errors := [row["error"] for row in mine if row.get("error")]:
            found.append(f"Trials of {controller} that failed or were stopped: {len(errors)}; the first: {errors[0]}.")
        if raised := [row["raised"] for row in mine if row.get("raised")]:
            count = f"Trials with exceptions or malformed answers of {controller}: {len(raised)}"
            found.append(f"{count}; in the first of them: {raised[0]}.")
        asked, refused = (sum(row.get(key) or 0 for row in mine) for key in ("asked", "faults"))
        if refused > 0.01 * asked:
            most = f", so the means say little about {controller}" if 2 * refused > asked else ""
            found.append(f"The supervisor replaced {100 * refused / asked:.0f} % of the answers of {controller}{most}.")
        return found

    @property
    def frame(self) -> pl.DataFrame:
        """The rows as a table, with null for numbers that are not finite."""
        rows = [plain(row) for row in self._rows]
        names = list(dict.fromkeys(name for row in rows for name in row))
        return pl.DataFrame([pl.Series(name, [row.get(name) for row in rows], strict=False) for name in names])

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the rows as Parquet. Raise a StudyError if the file cannot be written."""
        packed = io.BytesIO()
        self.frame.write_parquet(packed, compression="zstd")
        write_whole(path, packed.getvalue(), "rows", StudyError)
