"""Any grid or random sample over any field of a scenario, x solvers x seeds; stopped at any moment, it goes on.

python -m benchmarks.sweep [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--workers N] [--scheduler ADDRESS]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import output
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.dask import DaskPool
from benchmarks.sweeps.engine import Pool, Work, execute, run_all
from benchmarks.sweeps.local import LocalPool, cores
from benchmarks.sweeps.plan import Plan, quick
from benchmarks.sweeps.report import print_tables, write_report
from benchmarks.sweeps.store import Store
from benchmarks.sweeps.summary import errors, summarise
from moc_opt.errors import MocOptError
from moc_opt.report.console import console, progress


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sweep; 0, 1 where workers died for good, 2 with a message where the input or the machine is wrong."""
    options = output.parser("sweep", "Vary any field of a scenario, over solvers and seeds.")
    options.add_argument(
        "--workers", type=int, help="processes here (one for each core), or Dask workers to wait for"
    )
    options.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask scheduler: the runs are done there"
    )
    given = options.parse_args(arguments)
    try:
        config = Config.chosen(given, "sweep")
        if given.quick:
            config = quick(config)
        pool = choose_pool(given.scheduler, given.workers)
        lost = sweep(config, given.out, pool)
        summary = report(config, given.out, lost, list(arguments or sys.argv[1:]))
    except MocOptError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(
            f"stopped; what is finished is in {given.out}: the same command goes on from there",
            file=sys.stderr,
        )
        return 130
    if given.json:
        print((given.out / "summary.json").read_text(), end="")
    else:
        print_tables(console(), summary, given.out)
    return 1 if lost else 0


def choose_pool(scheduler: str | None, workers: int | None) -> Pool:
    """Processes here, or a cluster."""
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
                lost |= run_all(
                    pool, todo, lambda i: plan.scenario(i).model_dump(mode="json"), keep, limit, work
                )
            if again := store.verify():  # a disk may spoil what it has taken
                said.print(f"damaged, set aside: {again} runs are done again")
        for index, why in lost.items():
            said.print(f"run {index} ({plan.run_id(index)}): {why}")
        store.finish(lost)
    return lost


def report(config: Config, out: Path, lost: dict[int, str], argv: list[str]) -> dict[str, Any]:
    """summary.json, environment.json and report.html, from the finished tables."""
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
    environment = output.environment(config.model_dump(mode="json"), config.seed, argv)
    output.write_json(out / "summary.json", summary)
    output.write_json(out / "environment.json", environment)
    numeric = {path: vs for path, vs in fields.items() if all(type(v) in (int, float) for v in vs)}
    write_report(out / "report.html", summary, numeric, environment)
    return summary


if __name__ == "__main__":
    sys.exit(main())
