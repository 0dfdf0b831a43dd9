"""How often do the 95 % intervals of the solver study contain the true value?

python -m benchmarks.coverage [CONFIG.toml] [--out DIR] [--quick] [--json]

The true value is a metric's change from DCAC to MOC over a pool of trials. Intervals use trials drawn from this pool.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from moc_opt.errors import StudyError
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study import Failed, Job
from moc_opt.study.command import Found, Study, StudyConfig, command
from moc_opt.study.results import ERRORS, TITLES, Results
from moc_opt.study.show import Report, Section
from moc_opt.study.statistics import LEAST_TRIALS, relative_change
from moc_opt.study.trials import BASELINE, Trial, trials

SEED = 1_000_000
"""first seed of the pool, far from the seeds of every study"""
SOLVERS = ("exact", "rnn", "rnn-printed")
METRICS = ("mu_mean", *(ERRORS[k] for k in (3, 4, 0, 1)))
SIZES = (60, 15, LEAST_TRIALS)


class Config(StudyConfig):
    trials: int = Field(240, ge=2 * max(SIZES), description="trials in the pool")
    draws: int = Field(1000, ge=1, description="draws from the pool, for each number of trials")
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    scenario: Scenario = Scenario(duration_s=4.0, bound_samples=0, start={"pose": "random"})

    def quick(self) -> Self:
        few = {"trials": 2 * max(SIZES), "draws": 50, "scenario": self.scenario.change(duration_s=0.1)}
        return self.model_copy(update=few)

    def cases(self) -> list[Scenario]:
        return trials(self.scenario, self.tasks, range(SEED, SEED + self.trials))


def covered(treated: ArrayLike, control: ArrayLike, size: int, draws: int) -> tuple[float, float]:
    """Return (share of intervals that contain the true change [%], median width [%])."""
    treated, control = np.asarray(treated), np.asarray(control)
    rng, held, widths = np.random.default_rng(size), 0, []
    true = 100.0 * (treated.mean() / control.mean() - 1.0)
    for _ in range(draws):
        chosen = rng.integers(len(treated), size=size)
        found = relative_change(treated[chosen], control[chosen])
        held += found.low <= true <= found.high
        widths.append(found.high - found.low)
    return 100.0 * held / draws, float(np.median(widths))


def work(study: Study, config: Config) -> Found:
    starts, lost = study.placed(config.cases())
    asked = [Trial(case, name) for case in starts for name in (BASELINE, *SOLVERS)]
    pool = Results([*(run.row for run in study.trials(asked)), *lost])
    rows, jobs = [], []
    for solver, metric in product(SOLVERS, METRICS):
        both = pool.pairs(metric, solver)
        treated, control = np.array(both)
        rows.append({
            "solver": solver, "metric": metric, "change": TITLES.get(metric, "mu"), "trials": len(treated),
            "true_percent": 100.0 * (treated.mean() / control.mean() - 1.0),
            "ratios_percent": 100.0 * float(np.mean(treated / control - 1.0)),
        })  # fmt: skip
        jobs += [Job(covered, (*both, size, config.draws)) for size in SIZES]
    for (row, size), found in zip(product(rows, SIZES), study.run(jobs, "draws"), strict=True):
        if isinstance(found, Failed):
            raise StudyError(f"{row['solver']}, {row['metric']}: {found}")
        row[f"covered_{size}"], row[f"width_{size}"] = found
    summary = {"coverage": {f"{row['solver']} {row['metric']}": row for row in rows}}
    return Found(report(rows, config), summary, pool)


def report(rows: Sequence[dict[str, object]], config: Config) -> Report:
    named = [Column("solver", "solver"), Column("change", "change of")]
    table = Table(f"Nominal 95 % intervals: {config.draws} draws from {config.trials} trials", [
        *named, Column("true_percent", "true change", unit="%", format="+.1f"),
        Column("ratios_percent", "mean of ratios", unit="%", format="+.1f", help="mean of the trials' changes"),
        *(Column(f"covered_{size}", f"{size} trials", unit="%", format=".1f", section="Widths",
                 help="share of intervals that contain the true change") for size in SIZES),
    ], rows)  # fmt: skip
    widths = [Column(f"width_{size}", f"{size} trials", unit="%", format=".3g") for size in SIZES]
    shares = [float(str(row[f"covered_{size}"])) for row in rows for size in SIZES]
    answer = f"Nominal 95 % intervals contain the true change in {min(shares):.1f} to {max(shares):.1f} % of draws."
    folded = Section("Widths", "Medians over draws.", [Table("Widths of the intervals", [*named, *widths], rows)])
    return Report("How often the intervals contain the true change", [answer], table, sections=[folded])


main = partial(command, "coverage", "How often the intervals contain the true change.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
