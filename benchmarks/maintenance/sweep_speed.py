"""What the engine of a sweep costs, and what more workers bring: the same runs bare, on one worker, on several.

Other work on the machine spoils `over bare` and `speed-up`, which compare one time with another; `overhead` and
`parent` compare times of the same seconds, as shares of the time in runs, and stand it better; `others` says how
much of it there was. With --waiting the runs wait instead of computing: that shows the engine alone, on any machine.

python -m benchmarks.sweep_speed [--runs N] [--seconds S] [--workers N] [--rounds N] [--out DIR] [--json]
"""

from __future__ import annotations

import importlib
import os
import statistics
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, process_time, sleep
from typing import Any

from benchmarks.common import cli, output
from benchmarks.common.processes import Worker
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.dask import DaskPool
from benchmarks.sweeps.engine import Pool, Table, Work, execute, run_all
from benchmarks.sweeps.errors import WorkerError
from benchmarks.sweeps.local import THREADS, LocalPool
from benchmarks.sweeps.plan import Plan
from benchmarks.sweeps.store import Store
from benchmarks.sweeps.version import code_version
from moc_opt.report import tables as report

LIMIT_S = 600.0
COLUMNS = [
    report.Column("engine", "engine"),
    report.Column("seconds", "all runs", unit="s", format=".2f", help="folder and final tables included"),
    report.Column("start_s", "start", unit="s", format=".2f", help="workers begun and warm; once a sweep"),
    report.Column("run_s", "a run", unit="s", format=".3f", help="as the worker saw it"),
    report.Column("overhead_percent", "overhead", unit="%", format=".2f", better="low", help="workers not in a run"),
    report.Column("parent_percent", "parent", unit="%", format=".2f", better="low", help="CPU time of the parent"),
    report.Column("over_bare_percent", "over bare", unit="%", format="+.2f", help="one worker: time above a bare loop"),
    report.Column("others", "others", unit="cores", format=".2f", better="low", help="taken by other programs"),
    report.Column("speed_up", "speed-up", format=".2f", better="high", help="over one local worker"),
]  # fmt: skip


def the_plan(runs: int, ticks: int) -> Plan:
    """Plan runs of so many ticks each; nothing is judged, so that the time is all simulation."""
    scenario = {"duration_s": 0.002 * ticks, "judge": False, "bound_samples": 0}
    return Plan(Config(solvers=["exact"], seeds=runs, scenario=scenario)).number_runs()  # type: ignore[arg-type]


def calibrate(seconds: float) -> int:
    """Tell how many ticks take so long here; in a process of its own."""
    times = {}
    for ticks in (100, 100, 5100):  # the first one pays for compilers and caches
        table = scenario_table(the_plan(1, ticks), 0)
        times[ticks] = execute(table, LIMIT_S)["wall_s"]
    per_tick = (times[5100] - times[100]) / 5000
    return max(100, round((seconds - times[100]) / per_tick))


def pause(table: Table, limit_s: float) -> dict[str, Any]:
    """Wait as long as the scenario of a run lasts."""
    sleep(table["duration_s"])
    return {"error": None, "figures": {}, "wall_s": table["duration_s"], "version": code_version()}


def bare(tables: Sequence[Table], work: Work) -> float:
    """Do the runs in a loop, in a process of its own [s]."""
    work({**tables[0], "duration_s": 0.1}, LIMIT_S)
    begin = perf_counter()
    for table in tables:
        work(table, LIMIT_S)
    return perf_counter() - begin


def timed(plan: Plan, pool: Pool, workers: int, work: Work) -> dict[str, float]:
    """Do the runs as a sweep does them, folder and all."""
    tiny = [scenario_table(the_plan(2 * workers, 50), i) for i in range(2 * workers)]
    walls: list[float] = []
    begin = perf_counter()
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder) / "sweep", plan) as store, pool:
        run_all(pool, range(len(tiny)), tiny.__getitem__, lambda i, result: None, LIMIT_S, work)
        started, own = perf_counter(), process_time()

        def keep(index: int, result: dict[str, Any]) -> None:
            store.add(index, result)
            walls.append(result["wall_s"])

        run_all(pool, range(len(plan)), lambda i: scenario_table(plan, i), keep, LIMIT_S, work)
        store.finish({})
        seconds, own = perf_counter() - started, process_time() - own
    return {
        "seconds": seconds, "start_s": started - begin, "run_s": statistics.fmean(walls),
        "overhead_percent": 100.0 * (seconds * workers / sum(walls) - 1.0), "parent_percent": 100.0 * own / sum(walls),
    }  # fmt: skip


def scenario_table(plan: Plan, index: int) -> Table:
    """Return what a worker is given."""
    return plan.scenario(index).model_dump(mode="json")


@contextmanager
def dask_cluster(workers: int) -> Iterator[str]:
    """Make a scheduler with worker processes on this machine; yields its address."""
    LocalCluster: Any = importlib.import_module("distributed").LocalCluster

    with tempfile.TemporaryDirectory() as folder, LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None,
        worker_dashboard_address=None, local_directory=folder,
        scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
    ) as cluster:  # fmt: skip
        yield str(cluster.scheduler_address)


def cpu_seconds() -> tuple[float, float]:
    """Read the CPU time [s] that all programs of this machine have used, and this one with its ended children."""
    busy = [float(n) for n in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    idle = busy[3] + busy[4]
    own = os.times()
    return (sum(busy) - idle) / os.sysconf("SC_CLK_TCK"), sum(own[:4])


def others(turn: Callable[[], dict[str, float]]) -> dict[str, float]:
    """Return the figures of a turn, and how many cores other programs took meanwhile."""
    everybody, own, begin = *cpu_seconds(), perf_counter()
    found = turn()
    everybody_after, own_after = cpu_seconds()
    return found | {"others": (everybody_after - everybody - own_after + own) / (perf_counter() - begin)}


def contenders(plan: Plan, workers: int, work: Work) -> dict[str, Callable[[], dict[str, float]]]:
    """Name who does the runs, in the order of their turns."""
    scenarios = [scenario_table(plan, i) for i in range(len(plan))]

    def loop() -> dict[str, float]:
        with Worker(fresh=True) as alone:
            seconds = alone.call(bare, scenarios, work)
        return {"seconds": seconds, "run_s": seconds / len(plan)}

    def dask() -> dict[str, float]:
        with dask_cluster(workers) as address:
            return timed(plan, DaskPool(address, workers), workers, work)

    found = {
        "bare loop": loop,
        "1 worker": lambda: timed(plan, LocalPool(1), 1, work),
        f"{workers} workers": lambda: timed(plan, LocalPool(workers), workers, work),
    }
    if find_spec("distributed") is not None:  # an extra; the local figures stand without it
        found[f"Dask, {workers} workers"] = dask
    return found


def measure(runs: int, seconds: float, workers: int, rounds: int, waiting: bool) -> dict[str, dict[str, float]]:
    """Take medians over rounds; in each every engine has its turn, so that drift of the machine hits all."""
    for name in THREADS:
        os.environ.setdefault(name, "1")
    if waiting:
        plan = the_plan(runs, round(seconds / 0.002))
    else:
        with Worker(fresh=True) as alone:
            plan = the_plan(runs, alone.call(calibrate, seconds))
    turns = contenders(plan, workers, pause if waiting else execute)
    found: dict[str, list[dict[str, float]]] = {name: [] for name in turns}
    with cli.steps("speed", len(turns) * rounds) as step:
        for _ in range(rounds):
            for name, turn in turns.items():
                found[name].append(others(turn))
                step(name)
    for one, loop in zip(found["1 worker"], found["bare loop"], strict=True):
        one["over_bare_percent"] = 100.0 * (one["seconds"] / loop["seconds"] - 1.0)
    for figures in found.values():
        for mine, one in zip(figures, found["1 worker"], strict=True):
            mine["speed_up"] = one["seconds"] / mine["seconds"]
    return {
        name: {key: statistics.median(round_[key] for round_ in figures) for key in figures[0]}
        for name, figures in found.items()
    }


def compare(given: Namespace) -> cli.Results:
    """Measure every engine.

    Raises:
        WorkerError: numbers that make no measurement.
    """
    if min(given.runs, given.workers, given.rounds) < 1 or given.seconds <= 0.0:
        raise WorkerError("--runs, --workers, --rounds and --seconds: give one or more, and a positive time")
    settings = {name: getattr(given, name) for name in ("runs", "seconds", "workers", "rounds", "waiting")}
    found = measure(**settings)
    kind = "waiting runs" if given.waiting else "runs"
    title = f"{given.runs} {kind} of about {given.seconds:g} s, medians of {given.rounds} rounds"
    table = report.Table(title, COLUMNS, [{"engine": name, **figures} for name, figures in found.items()])
    return cli.Results({"speed": found}, output.environment(settings, 0, given.argv), tables=[table])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the measurement; see `cli.run` for the exit status."""
    options = cli.parser("sweep_speed", "What the engine of a sweep costs.", configured=False)
    options.add_argument("--runs", type=int, default=16)
    options.add_argument("--seconds", type=float, default=2.0, help="how long a run should take")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--waiting", action="store_true", help="runs that wait, for a machine that others use")
    return cli.run(options, compare, arguments)


if __name__ == "__main__":
    sys.exit(main())
