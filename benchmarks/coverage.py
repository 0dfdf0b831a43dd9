"""How often the intervals of the study of solvers hold the true change, by simulation with the study's own design.

python -m benchmarks.coverage [--trials N] [--draws N] [--processes N] [--out DIR]

Fresh independent trials make a pool, and the change over the whole pool counts as the true one. From it trials are
drawn with replacement, as many as the study has, with the interval of `moc_opt.study.statistics` around the
change of each draw. docs/method.md has the result.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from benchmarks.common import cli, output
from moc_opt.arrays import Array
from moc_opt.errors import ScenarioError
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, run
from moc_opt.study import Kept, each
from moc_opt.study.solver_closed_loop import CHANGES
from moc_opt.study.solvers import Config
from moc_opt.study.statistics import relative_change
from moc_opt.study.trials import BASELINE, placed, variant
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import summarize

SEED = 1_000_000
"""Far from the trials of every study."""
SOLVERS = ("exact", "rnn", "rnn-printed")
COLUMNS = [
    Column("solver", "solver"), Column("metric", "change of"), Column("true_percent", "pool", unit="%", format=".3g"),
    Column("ratios_percent", "mean of ratios", unit="%", format=".3g", help="of the pool"),
    Column("covered_60", "60 trials", unit="%", format=".1f", help="of the draws whose interval holds the pool's"),
    Column("covered_15", "15 trials", unit="%", format=".1f"),
    Column("width_60", "width of 60", unit="%", format=".3g", help="of the interval, median"),
    Column("width_15", "width of 15", unit="%", format=".3g"),
]  # fmt: skip
SIZES = (60, 15)


def metrics_of(given: tuple[Scenario, Mapping[str, Mapping[str, Any]]]) -> dict[str, dict[str, float]]:
    """Run one trial under all controllers: controller -> metric -> value; without those that broke off."""
    trial, settings = given
    found = {}
    for name in (BASELINE, *settings):
        trace = run(variant(trial, name, settings.get(name)))
        if Ending.of(str(trace.meta["ended"])).whole:
            values = summarize(trace)
            found[name] = {metric: float(values[metric]) for metric in CHANGES}
    return found


def covered(given: tuple[Array, Array, int, int]) -> tuple[float, float]:
    """Return the share of draws whose interval holds the pool's change [percent], and its median width [percent].

    The arguments come as one tuple: treated and control of the pool (k,), trials of a draw, and the number of draws.
    """
    treated, control, size, draws = given
    rng, held, widths = np.random.default_rng(size), 0, []
    true = 100.0 * (treated.mean() / control.mean() - 1.0)
    for _ in range(draws):
        chosen = rng.integers(len(treated), size=size)
        found = relative_change(treated[chosen], control[chosen])
        held += found.low <= true <= found.high
        widths.append(found.high - found.low)
    return 100.0 * held / draws, float(np.median(widths))


def measure(given: Namespace) -> cli.Results:
    """Run the pool and draw from it.

    Raises:
        ScenarioError: too few trials to be a pool, or no draws.
    """
    if given.trials < 2 * max(SIZES) or min(given.draws, given.processes) < 1:
        raise ScenarioError(f"--trials {given.trials}: give {2 * max(SIZES)} or more; --draws, --processes: 1 or more")
    part = {"trials": given.trials}
    config = Config(seed=SEED, scenario={"bound_samples": 0}, closed_loop=part)
    settings: dict[str, dict[str, Any]] = {name: {} for name in SOLVERS}
    jobs = [(placed(trial), settings) for trial in config.cases()]
    kept = Kept(given.out / "jobs")
    with cli.steps("trials", len(jobs)) as step:
        found = each(metrics_of, jobs, kept=kept, workers=given.processes, step=step)
    rows, asked = [], []
    for solver, metric in product(SOLVERS, CHANGES):
        both = [(one[solver][metric], one[BASELINE][metric]) for one in found if solver in one and BASELINE in one]
        treated, control = np.array(both).T
        asked += [(treated, control, size, given.draws) for size in SIZES]
        rows.append({
            "solver": solver, "metric": metric, "trials": len(both),
            "true_percent": 100.0 * (treated.mean() / control.mean() - 1.0),
            "ratios_percent": 100.0 * float(np.mean(treated / control - 1.0)),
        })  # fmt: skip
    with cli.steps("draws", len(asked)) as step:
        shares = iter(each(covered, asked, workers=given.processes, step=step))
    for row, size in product(rows, SIZES):
        row[f"covered_{size}"], row[f"width_{size}"] = next(shares)
    title = f"Coverage of nominal 95 % intervals: {given.draws} draws from {given.trials} trials"
    environment = output.environment({"trials": given.trials, "draws": given.draws}, SEED, given.argv)
    summary = {"coverage": {f"{row['solver']} {row['metric']}": row for row in rows}}
    return cli.Results(summary, environment, tables=[Table(title, COLUMNS, rows)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulation; see `cli.run` for the exit status."""
    options = cli.parser("coverage", "How often the study's intervals hold the true change.", configured=False)
    options.add_argument("--trials", type=int, default=240, help="of the pool")
    options.add_argument("--draws", type=int, default=1000, help="from the pool, of each number of trials")
    options.add_argument("--processes", type=int, default=2)
    return cli.run(options, measure, arguments)


if __name__ == "__main__":
    sys.exit(main())
