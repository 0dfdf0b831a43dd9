"""Any grid or random sample over any field of a scenario, x solvers x seeds; stopped at any moment, it goes on.

python -m benchmarks.sweep [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--workers N] [--dask ADDRESS]
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from time import perf_counter
from typing import Any

import polars as pl

from benchmarks.common import cli
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.fields import grid_axes
from benchmarks.sweeps.plan import Run, plan
from benchmarks.sweeps.report import answer, page, tables
from moc_opt import scenario
from moc_opt.inputs.files import to_json
from moc_opt.report.console import console
from moc_opt.scenario import Scenario
from moc_opt.study import Failed, Job, Kept, engine
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import METRICS, summarize

ENDINGS = (Ending.STOPPED.value, Ending.OSCILLATED.value)
MOST_ERRORS = 20


def do_run(case: Scenario) -> dict[str, Any]:
    """Do one run, in a worker: how it ended, how it was timed, and its metrics."""
    begin = perf_counter()
    trace = scenario.run(case)
    wall_s, shared = perf_counter() - begin, engine.shared()
    return {"ended": str(trace.meta["ended"]), "timing_shared": shared, "wall_s": wall_s, **summarize(trace)}


def sweep(config: Config, given: Namespace) -> list[dict[str, Any]]:
    """Do what is not done yet; return a row for each run, with ``error`` where it has no result."""
    runs = plan(config)
    jobs = [Job(do_run, (run.scenario,), config.run_limit_s) for run in runs]
    kept = Kept(given.out / "jobs")
    with cli.steps("sweep", len(jobs)) as step:
        done = engine.run(jobs, kept=kept, workers=given.workers, dask=given.dask, done=lambda job, row: step())
    if kept.reused:
        console(stderr=True).print(f"{kept.reused} of {len(jobs)} runs were finished before")
    return [row_of(k, run, result) for k, (run, result) in enumerate(zip(runs, done, strict=True))]


def row_of(index: int, run: Run, result: dict[str, Any] | Failed) -> dict[str, Any]:
    """Return a row of rows.parquet; a value that is a list or table stands as the text of its JSON."""
    values = {
        path: to_json(value, indent=None) if isinstance(value, list | dict) else value
        for path, value in run.values.items()
    }
    row = {"index": index, "run": run.id, "solver": run.solver, "seed": run.seed, **values}
    if isinstance(result, Failed):
        return row | {"ended": "failed", "error": str(result)}
    return row | {"error": None} | result


def summarise(rows: Sequence[dict[str, Any]], by: Sequence[str] = ("solver",)) -> dict[str, dict[str, Any]]:
    """Count runs, failures, and for each metric {count, mean, min, max, p05, p50, p95}, in groups.

    Runs that were stopped are counted, and enter no metric: theirs are figures of a part.
    """
    found: dict[str, dict[str, Any]] = {}
    for values in dict.fromkeys(tuple(row[name] for name in by) for row in rows):
        mine = [row for row in rows if tuple(row[name] for name in by) == values]
        ended = [str(row["ended"]) for row in mine]
        group: dict[str, Any] = {"runs": len(mine), "failed": sum(row["error"] is not None for row in mine)}
        group |= {word: sum(text.startswith(word) for text in ended) for word in ENDINGS}
        whole = pl.DataFrame(
            [{name: row.get(name) for name in METRICS} for row in mine if not row["ended"].startswith(ENDINGS[0])],
            schema=dict.fromkeys(METRICS, pl.Float64),
        )
        for name in METRICS:
            column = whole[name].drop_nulls()
            column = column.filter(column.is_finite())
            if len(column):
                group[name] = {
                    "count": len(column), "mean": column.mean(), "min": column.min(), "max": column.max(),
                    **{f"p{p:02d}": column.quantile(p / 100.0, "linear") for p in (5, 50, 95)},
                }  # fmt: skip
        found[", ".join(map(str, values))] = group
    return found


def study(given: Namespace) -> cli.Results:
    """Do the runs that are not done yet, and summarise all of them."""
    config = Config.chosen(given, "sweep")
    rows = sweep(config, given)
    solvers = summarise(rows)
    alone = [row for row in rows if row.get("timing_shared") is False]
    counted = {
        "all": len(rows), **{word: sum(group[word] for group in solvers.values()) for word in ("failed", *ENDINGS)},
        "timed_alone": len(alone), "timed_shared": sum(row.get("timing_shared") is True for row in rows),
    }  # fmt: skip
    errors = [row["error"] for row in rows if row["error"] is not None]
    common = sorted(dict.fromkeys(errors), key=errors.count, reverse=True)[:MOST_ERRORS]
    fields = {path: values for path, values in grid_axes(config.grid).items() if len(values) > 1}
    summary: dict[str, Any] = {"sweep": {"runs": counted}, "solvers": solvers}
    summary |= {f"by {path}": summarise(rows, ["solver", path]) for path in fields}
    summary |= {"latency": summarise(alone), "errors": {text: {"runs": errors.count(text)} for text in common}}
    lost = any(str(row["error"]).startswith(("hung", "crashed")) for row in rows)
    environment = config.environment(given)
    numeric = {path: vs for path, vs in fields.items() if all(type(v) in (int, float) for v in vs)}
    first = answer(summary, numeric)
    return cli.Results(
        summary, environment, rows, page(summary, numeric, first, environment), tables=tables(summary)[1:],
        answer=first, status=1 if lost else 0,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sweep; see `cli.run` for the exit status."""
    options = cli.parser("sweep", "Vary any field of a scenario, over solvers and seeds.")
    options.add_argument("--workers", type=cli.whole_number, help="processes on this machine; default: one a core")
    options.add_argument("--dask", metavar="ADDRESS", help="of a Dask scheduler: the runs are done there")
    return cli.run(options, study, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
