"""A small sweep whose runs take no time, for the tests of sweeps."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sweeps import engine
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.plan import Plan
from benchmarks.sweeps.store import Store
from benchmarks.sweeps.version import code_version

TINY = {"duration_s": 0.05, "judge": False, "bound_samples": 0}
GRID = {"control.regularization": [1e-6, 1e-5, 1e-4], "plant.mass_error": [0.0, 0.1]}


def config(**changes: Any) -> Config:
    """12 runs: 3 x 2 x 2 seeds."""
    return Config(**{"grid": GRID, "seeds": 2, "solvers": ["exact"], "scenario": TINY, **changes})


def made_up(table: Any, limit_s: float) -> dict[str, Any]:
    """A run that takes no time: its figures follow from its scenario, its clock does not."""
    size = table["plant"]["mass_error"] + table["seed"] + table["control"]["regularization"]
    error = "SolverError: made up" if table["seed"] == 1 and table["plant"]["mass_error"] == 0.1 else None
    figures = {} if error else {"mu_mean": size, "loss_max": float("nan"), "tick_p50_us": time.perf_counter()}
    return {"error": error, "figures": figures, "wall_s": time.perf_counter(), "version": code_version()}


class Here:
    """A pool that does the runs at once, in this process."""

    shared, attempts = False, 2
    deaths: tuple[type[BaseException], ...] = (ChildProcessError,)

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *exc: object) -> None: ...

    def window(self) -> int:
        return 2

    def submit(self, work: Any, table: Any, limit_s: float) -> Future[dict[str, Any]]:
        future: Future[dict[str, Any]] = Future()
        try:
            future.set_result(work(table, limit_s))
        except Exception as error:  # noqa: BLE001 - as an executor does
            future.set_exception(error)
        return future


def do(
    plan: Plan, folder: Path, work: Any = made_up, todo: Callable[[Any], Any] = iter
) -> tuple[bytes, list[str]]:
    """Do what is left; the final table's bytes and what was found damaged."""
    with Store(folder, plan) as store:
        left = np.flatnonzero(~store.done).tolist()
        tables = [plan.scenario(i).model_dump(mode="json") for i in range(len(plan))]
        lost = engine.run_all(Here(), todo(left), tables.__getitem__, store.add, 10.0, work)
        store.finish(lost)
        return (folder / "rows.parquet").read_bytes(), store.dropped
