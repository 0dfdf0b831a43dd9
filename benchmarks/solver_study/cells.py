"""Evaluation of answers and times: judged, counted, and summed up without a mean that hides a tail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.solver_study.answers import CRASHED, HUNG, NOT_ASKED, RAISED, REFUSED, Data, Part
from benchmarks.solver_study.settings import SolverSetting
from benchmarks.subproblems.testset import TestSet
from moc_opt.qp.problem import compute_residuals, fields
from moc_opt.qp.residuals import Residuals
from moc_opt.study.timing import Disturbance, percentiles

CONTRADICTION = 1e-13  # m/s; above the rounding of consistent references
RIGHTLY = 0.99
"""Least share of right answers (see `share_right`) of a solver whose times are compared: a wrong one may come fast."""
RESIDUALS = ("primal", "natural", "natural_best", "relative", "loss")


@dataclass(frozen=True)
class Cell:
    """The answers of one solver under one setting to one set, judged."""

    setting: SolverSetting
    data: Data
    part: Part

    @cached_property
    def residuals(self) -> Residuals:
        """Of each answer, in the linear problem."""
        return compute_residuals(self.data.judged, self.part.arrays["x"], self.part.arrays["y"])

    @cached_property
    def verified(self) -> NDArray[np.bool_]:
        """(k,) which answers are optimal, whatever was claimed."""
        return np.asarray(self.residuals.verified() & self.data.feasible)

    @property
    def status(self) -> NDArray[Any]:
        """One word per problem."""
        return self.part.arrays["status"]

    @property
    def contradictory(self) -> NDArray[np.bool_]:
        """Where the six rows cannot all be met: their references were moved before the certificate was made."""
        moved = np.abs(fields(self.data.judged).b - fields(self.data.rows).b).max(axis=-1)
        return moved > CONTRADICTION

    @property
    def right(self) -> NDArray[np.bool_]:
        """(k,) which problems were answered rightly, the one rule of all tables, figures and sentences.

        Right is a claim of success that the judge verifies, and a claim of infeasibility that the certificate confirms.
        """
        return (self.status == "solved") & self.verified | (self.status == "infeasible") & ~self.data.feasible

    @property
    def inconsistent(self) -> NDArray[np.bool_]:
        """(k,) where the solver was given six rows that contradict each other, and five of them have an optimum."""
        return self.contradictory & self.data.feasible & self.setting.six_rows

    @property
    def refused_inconsistent(self) -> NDArray[np.bool_]:
        """(k,) where it called such rows infeasible: true of the rows, no answer for the robot.

        This counts neither as right nor as wrong.
        """
        return self.inconsistent & (self.status == "infeasible")

    @property
    def refused(self) -> str:
        """Why the solver does not take these problems; "" where it does."""
        return str(self.part.values["reason"])

    @property
    def trouble(self) -> str:
        """What the solver raised, or how its process ended, at the first problem where it did; "" where never."""
        events = [event for event in self.part.values["events"] if event != NOT_ASKED]
        return f"{self.data.name}, {events[0]}" if events else ""

    @property
    def complete(self) -> bool:
        """Every problem was answered, somehow."""
        return not np.isin(self.status, (HUNG, CRASHED, NOT_ASKED, REFUSED)).any()

    def counts(self) -> dict[str, int]:
        """Count the answers by outcome: right, wrong and refused ones add up to the number of problems.

        Two kinds of question have a right answer: `optima_asked` (what is feasible and was not refused) have
        `verified_solved`, and `infeasible_asked` have `infeasible_right`. Of `inconsistent_asked` problems (see
        `inconsistent`), `refused_inconsistent` were refused; the others are among the optima asked.
        """
        status, feasible = self.status, self.data.feasible
        claimed, infeasible = status == "solved", status == "infeasible"
        certified = infeasible & ~feasible
        declined = self.refused_inconsistent
        broken = {name: int((status == name).sum()) for name in (HUNG, CRASHED, RAISED)}
        failed = ~claimed & ~certified & ~declined & ~np.isin(status, (HUNG, CRASHED, NOT_ASKED, REFUSED))
        return {
            "solves": len(status),
            "feasible": int(feasible.sum()),
            "right": int(self.right.sum()),
            "optima_asked": int((feasible & ~declined).sum()),
            "infeasible_asked": int((~feasible).sum()),
            "inconsistent_asked": int(self.inconsistent.sum()),
            "claimed_solved": int(claimed.sum()),
            "verified_solved": int((claimed & self.verified).sum()),
            "verified": int(self.verified.sum()),
            "silently_wrong": int((claimed & ~self.verified).sum()),
            "infeasible_right": int(certified.sum()),
            "refused_inconsistent": int(declined.sum()),
            "infeasible_wrong": int((infeasible & feasible & ~declined).sum()),
            "failed": int(failed.sum()),
            **broken,
            "not_asked": int(np.isin(status, (NOT_ASKED, REFUSED)).sum()),
        }

    @cached_property
    def figures(self) -> dict[str, float | None]:
        """Median, 99th percentile and maximum of the residuals over the feasible problems that were answered."""
        given = self.data.feasible & np.isfinite(self.part.arrays["x"]).all(axis=1)
        found: dict[str, float | None] = {}
        for name in RESIDUALS:
            values = np.asarray(getattr(self.residuals, name))[given]
            three = np.percentile(values, (50.0, 99.0, 100.0)).tolist() if values.size else [None] * 3
            found |= {f"{name}_{word}": value for word, value in zip(("p50", "p99", "max"), three, strict=True)}
        found["iterations_p50"] = float(np.median(self.part.arrays["iterations"]))
        return found

    def summary(self, times: Part | None = None) -> dict[str, Any]:
        """Return counts, residuals and times for summary.json."""
        found: dict[str, Any] = {**self.counts(), **self.figures}
        if self.refused:
            found["reason"] = self.refused
        if self.trouble:
            found["trouble"] = self.trouble
        return {**found, **({} if times is None else time_figures(times))}

    def rows(self, part: str) -> list[dict[str, Any]]:
        """Return one row per problem, for rows.parquet."""
        return [
            {
                "part": part, "solver": self.setting.solver, "setting": self.setting.name, "set": self.data.name,
                "index": i, "status": str(self.status[i]), "iterations": int(self.part.arrays["iterations"][i]),
                "feasible": bool(self.data.feasible[i]), "verified": bool(self.verified[i]),
                **{name: float(getattr(self.residuals, name)[i]) for name in RESIDUALS},
            }
            for i in range(len(self.status))
        ]  # fmt: skip


def time_figures(times: Part) -> dict[str, Any]:
    """Compute percentiles of the times, and say of how many solves, and what the machine did while they ran warm."""
    warm, cold = (Disturbance(**times.values.get(kind, {})) for kind in ("warm", "cold"))
    found: dict[str, Any] = {"timed_solves": int(times.arrays["solve_us"].size), **warm.entries()}
    for kind, seen in {"solve": warm, "cold": cold, "setup": cold, "update": cold}.items():
        found |= percentiles(times.arrays[f"{kind}_us"].ravel(), kind, seen)
    return found


def share_right(counts: Mapping[str, Any]) -> float:
    """Return the share of right answers (`Cell.right`) among the problems that were not refused as inconsistent."""
    asked = counts.get("solves", 0) - counts.get("refused_inconsistent", 0)
    return float(counts["right"] / asked) if asked else 0.0


def answers_rightly(counts: Mapping[str, Any]) -> bool:
    """Return whether a solver's times may be compared with others': see `RIGHTLY`."""
    return share_right(counts) >= RIGHTLY


def totals(cells: Sequence[Cell], timings: Mapping[str, Part]) -> dict[str, Any]:
    """Sum up one solver under one setting over its sets: sums of counts, largest of maxima, worst of percentiles."""
    found: dict[str, Any] = {}
    for cell in cells:
        for name, count in cell.counts().items():
            found[name] = found.get(name, 0) + count
    for name in RESIDUALS:
        values = [v for cell in cells if (v := cell.figures[f"{name}_max"]) is not None]
        found[f"{name}_max"] = max(values) if values else None
    trouble = next((cell.trouble for cell in cells if cell.trouble), "")
    found |= {"trouble": trouble} if trouble else {}
    figures = [time_figures(part) for part in timings.values()]
    for name in dict.fromkeys(name for f in figures for name in f):
        if name.endswith("_us"):
            # of the slowest set: a mean over sets would hide it
            found[f"{name}_worst_set"] = max(f[name] for f in figures if name in f)
    return found | (Disturbance.total(figures).entries() if figures else {})


def load(name: str, every: int = 1) -> Data:
    """Load a certified set."""
    kept = TestSet.load(name)
    return Data(name, kept.rows, kept.judged(), kept.feasible).thinned(every)


def cold_only(times: Part) -> Part:
    """Return the cold part of timings, under the names that solves have."""
    nothing = np.empty(0)
    arrays = {"solve_us": times.arrays["cold_us"], "setup_us": times.arrays["setup_us"]}
    values = {**times.values, "warm": times.values.get("cold", {})}
    return Part(values, {**arrays, "cold_us": nothing, "update_us": nothing})


def costs_of(cells: Sequence[Cell], measured: Mapping[str, Part]) -> NDArray[np.float64]:
    """Return the median time of each problem over the rounds [us], infinite where it was not answered rightly.

    Nothing where the median over a set is not to be trusted.
    """
    if not all(Disturbance(**part.values.get("warm", {})).trusts(50.0) for part in measured.values()):
        return np.empty(0)
    found = []
    for cell in cells:
        times = measured[cell.data.name].arrays["solve_us"] if cell.data.name in measured else ()
        found.append(np.where(cell.right, np.median(times, axis=0) if len(times) else np.inf, np.inf))
    return np.concatenate(found)


def solved_duals(part: Part) -> NDArray[np.float64]:
    """Return the duals (k, 6) of the answers that the solver calls solved; NaN elsewhere."""
    return np.where((part.arrays["status"] == "solved")[:, None], part.arrays["y"], np.nan)
