"""Any grid or random sample over any field of a scenario, x solvers x seeds; stopped at any moment, it goes on.

python -m benchmarks.sweep [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--workers N] [--scheduler ADDRESS]
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import cli
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.dask import DaskPool
from benchmarks.sweeps.engine import Pool, Work, execute, run_all
from benchmarks.sweeps.local import LocalPool, cores
from benchmarks.sweeps.plan import Plan
from benchmarks.sweeps.report import answer, page, tables
from benchmarks.sweeps.store import Store
from benchmarks.sweeps.summary import errors, summarise
from moc_opt.report.console import console, progress


def choose_pool(scheduler: str | None, workers: int | None) -> Pool:
    """Choose processes here, or a cluster."""
    if scheduler is not None:
        return DaskPool(scheduler, workers)
    return LocalPool(cores() if workers is None else workers)


def sweep(config: Config, out: Path, pool: Pool, work: Work = execute) -> dict[int, str]:
    """Do what is not done yet, and write rows.parquet and clock.parquet.

    Returns:
        index -> why there is no result, of the runs that took their worker down every time.

    Raises:
        MocOptError: what is wrong with the configuration, the folder or the workers; what is finished stays.
    """
    plan = Plan(config)
    with progress("planning", plan.combinations) as bar:
        plan.number_runs(bar.advance)
    plan.check_names()
    with Store(out, plan) as store:
        said = console(stderr=True)
        for path in store.dropped:
            said.print(f"damaged, set aside, its runs are done again: {path}")
        finished = int(store.done.sum())
        if 0 < finished < len(plan):
            said.print(f"going on: {finished} of {len(plan)} runs are finished")
        lost: dict[int, str] = {}
        while todo := [i for i in np.flatnonzero(~store.done).tolist() if i not in lost]:
            with pool, progress("sweep", len(todo)) as bar:

                def keep(index: int, result: dict[str, Any]) -> None:
                    store.add(index, result)
                    bar.advance()
                    bar.at(plan.point(index).solver)

                limit = config.run_limit_s
                lost |= run_all(pool, todo, lambda i: plan.scenario(i).model_dump(mode="json"), keep, limit, work)
            if again := store.verify():  # a disk may spoil what it has taken
                said.print(f"damaged, set aside: {again} runs are done again")
        for index, why in lost.items():
            said.print(f"run {index} ({plan.run_id(index)}): {why}")
        store.finish(lost)
    return lost


def study(given: Namespace) -> cli.Results:
    """Do the runs that are not done yet, and summarise all of them; status 1 where workers died for good."""
    config = Config.chosen(given, "sweep")
    lost = sweep(config, given.out, choose_pool(given.scheduler, given.workers))
    return report(config, given, lost)


def report(config: Config, given: Namespace, lost: dict[int, str]) -> cli.Results:
    """Summarise the finished tables of a sweep."""
    out = given.out
    plan = Plan(config)
    fields = {path: values for path, values in plan.grid.items() if len(values) > 1}
    alone = summarise(out, ["solver"], "clock", alone=True)
    solvers = summarise(out)
    counted = {
        "all": sum(group["runs"] for group in solvers.values()),
        "failed": sum(group["failed"] for group in solvers.values()),
        "stopped": sum(group["stopped"] for group in solvers.values()),
        "oscillated": sum(group["oscillated"] for group in solvers.values()),
        "lost": len(lost),
        "timed_alone": sum(group["runs"] for group in alone.values()),
    }
    counted["timed_shared"] = counted["all"] - counted["timed_alone"] - counted["lost"]
    summary: dict[str, Any] = {"sweep": {"runs": counted}, "solvers": solvers}
    summary |= {f"by {path}": summarise(out, ["solver", path]) for path in fields}
    summary |= {"latency": alone, "errors": errors(out)}
    environment = config.environment(given)
    numeric = {path: vs for path, vs in fields.items() if all(type(v) in (int, float) for v in vs)}
    first = answer(summary, numeric)
    return cli.Results(
        summary, environment, page=page(summary, numeric, first, environment), tables=tables(summary)[1:],
        answer=first, files=["rows.parquet", "clock.parquet"], status=1 if lost else 0,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sweep; see `cli.run` for the exit status."""
    options = cli.parser("sweep", "Vary any field of a scenario, over solvers and seeds.")
    options.add_argument("--workers", type=int, help="processes here (one for each core), or Dask workers to wait for")
    options.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler: the runs are done there")
    left = "stopped; what is finished is in {out}: the same command goes on from there"
    return cli.run(options, study, arguments, left)


if __name__ == "__main__":
    sys.exit(main())
