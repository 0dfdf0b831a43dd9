"""A study of your own: the effect of the drives' delay under two solvers, in ten trials per solver and delay.

python examples/own_study.py [OUT] [tcp://DASK-SCHEDULER:8786]
"""

import sys
from pathlib import Path

import polars as pl

import moc_opt as mo
from moc_opt.study import Failed, Job, Kept, run


def trial(solver, delay, seed):
    scenario = mo.Scenario(duration_s=2.0, seed=seed, start={"pose": "random"}, bound_samples=0)
    scenario = scenario.change(solver={"name": solver}, plant={"delay_ticks": delay})
    return {"solver": solver, "delay": delay, "seed": seed, **mo.summarize(mo.run(scenario))}


if __name__ == "__main__":
    out, dask = Path(sys.argv[1] if len(sys.argv) > 1 else "results/delays"), (sys.argv + [None] * 2)[2]
    jobs = [Job(trial, (s, d, k)) for s in ("exact", "osqp") for d in (1, 3) for k in range(10)]
    rows = [row for row in run(jobs, kept=Kept(out / "jobs"), dask=dask) if not isinstance(row, Failed)]
    table = pl.DataFrame(rows).group_by("solver", "delay", maintain_order=True)
    print(table.agg(pl.len().alias("trials"), pl.col("mu_mean", "rcm_error_mean_mm").mean()))
