"""Measure plant and controller as two real-time processes.

python -m benchmarks.realtime [CONFIG.toml] [--cycles N] [--out DIR] [--seed N] [--quick] [--json]

Run nothing else meanwhile. The same command continues a stopped measurement.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field

from benchmarks.goals import Goal, goals_sentence, goals_table, judge
from moc_opt.arrays import Array
from moc_opt.errors import StudyError
from moc_opt.export import export_scenario
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study import Failed, Job
from moc_opt.study.command import Found, Study, StudyConfig, command, environment
from moc_opt.study.results import Results
from moc_opt.study.show import Report, Section, about
from moc_opt.study.statistics import Interval, share
from moc_opt.trace.trace import Trace

SPARE_S = 300.0
"""time allowed for starting and saving"""
SAFE_RCM_M, AT_REST_RAD_PER_S = 2e-3, 1e-2
"""A stop is clean if the RCM error and the final joint speed are below these limits."""
BURN = "import os\nstudy = os.getppid()\nwhile os.getppid() == study:\n    sum(i * i for i in range(100000))"
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99_99": 99.99, "worst": 100.0}
TIMES = {"wake": "wake-up latency", "round": "round trip", "control": "controller"}
LANGUAGES = {"python": "Python", "c": "C"}
DETAILS = "Cycles, times and stops"

Rate = Literal[250, 500, 1000]


class Case(NamedTuple):
    controller: str
    rate_Hz: Rate
    load: str

    def __str__(self) -> str:
        return f"{LANGUAGES[self.controller]}, {self.rate_Hz} Hz, {self.load}"


class Config(StudyConfig):
    cycles: int = Field(100_000, ge=100, description="cycles of every case")
    run_cycles: int = Field(20_000, ge=100, description="cycles of one run")
    rates_Hz: list[Rate] = Field([500, 1000], min_length=1)
    controllers: list[Literal["python", "c"]] = Field(["python", "c"], min_length=1)
    loads: list[Literal["quiet", "loaded"]] = Field(["quiet", "loaded"], min_length=1)
    scenario: Scenario = Scenario()

    def quick(self) -> Self:
        return self.model_copy(update={"cycles": 1000, "run_cycles": 1000, "rates_Hz": self.rates_Hz[:1]})

    def measured(self) -> list[Case]:
        return [Case(c, rate, load) for rate in self.rates_Hz for load in self.loads for c in self.controllers]

    def run_at(self, rate_Hz: Rate) -> Scenario:
        plant = {"period_s": 1.0 / rate_Hz, "substeps": max(1, round(1000 / rate_Hz))}
        cycles = min(self.cycles, self.run_cycles)
        return self.scenario.change(
            name="realtime", seed=self.seed, duration_s=cycles / rate_Hz, plant=plant, judge=False, bound_samples=0
        )


def work(study: Study, config: Config) -> Found:
    if study.given.cycles is not None:
        config = Config(**config.model_dump() | {"cycles": study.given.cycles})
    runs = runs_of(study, config)
    summary: dict[str, Any] = {"cases": {str(case): summarise(mine) for case, mine in runs.items()}}
    summary["goals"] = judge(summary, GOALS)
    shown = ("begun", "missed", "overruns", "ended", "clean", "rcm_max_mm")
    rows = [
        {"case": str(case), "run": k, "cycles": len(run.round_us), **{name: getattr(run, name) for name in shown},
         "round_worst_us": float(run.round_us.max()), "wake_worst_us": float(run.wake_us.max())}
        for case, mine in runs.items() for k, run in enumerate(mine)
    ]  # fmt: skip
    told = {
        "system": {str(case): mine[0].system for case, mine in runs.items()},
        "collector": "Python's garbage collector is off in the loops of plant and controller"}  # fmt: skip
    return Found(report(summary, about(config.scenario, solver=True)), summary, Results(rows), told)


# --- runs ---


class Run(NamedTuple):
    """Times [us] and counts of the cycles before the end or a stop. ``overruns``: ticks begun over a period late."""

    wake_us: Array
    round_us: Array
    control_us: Array
    missed: int
    overruns: int
    ended: str
    clean: bool
    rcm_max_mm: float
    system: dict[str, Any]
    begun: str


def runs_of(study: Study, config: Config) -> dict[Case, list[Run]]:
    scenarios = {rate: config.run_at(rate) for rate in config.rates_Hz}
    programs = {
        ("c", rate): str(build(scenario, study.out / "programs" / str(rate)))
        for rate, scenario in scenarios.items() if "c" in config.controllers
    }  # fmt: skip
    machine = environment({}, 0)["machine"]
    here = (machine["processor"], machine["cores"])  # only keeps saved results of other machines apart
    each = min(config.cycles, config.run_cycles)
    asked = [(case, number) for case in config.measured() for number in range(-(-config.cycles // each))]
    jobs = []
    for case, number in asked:
        given = (case, scenarios[case.rate_Hz], programs.get((case.controller, case.rate_Hz)), number, here)
        jobs.append(Job(run_once, given, each / case.rate_Hz + SPARE_S, alone=True, group=str(case)))
    found: dict[Case, list[Run]] = {}
    for (case, _), run in zip(asked, study.run(jobs, "runs"), strict=True):
        if isinstance(run, Failed):
            raise StudyError(f"{case}: {run}")
        found.setdefault(case, []).append(run)
    return found


def build(scenario: Scenario, folder: Path) -> Path:
    export_scenario(scenario, folder, udp=True)
    done = subprocess.run(["make", "-C", str(folder), "moc_udp"], capture_output=True, text=True, check=False)
    if done.returncode:
        raise StudyError(f"make moc_udp failed:\n{done.stderr[-2000:]}")
    return folder / "moc_udp"


@contextmanager
def loaded(kind: str) -> Iterator[None]:
    """Keep every core busy during the block, unless ``kind`` is "quiet"."""
    count = 0 if kind == "quiet" else os.cpu_count() or 1
    busy = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def run_once(case: Case, scenario: Scenario, program: str | None, number: int, machine: Any) -> Run:
    """Run a scenario with the C controller ``program`` (None: the Python controller)."""
    begun = datetime.now(UTC).isoformat(timespec="seconds")
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder, loaded(case.load):
        file, trace = Path(folder, "run.toml"), Path(folder, "run.parquet")
        scenario.save(file)
        plant = _started("plant", str(file), "--listen", "127.0.0.1:0", "--trace", str(trace), "--json")
        control: subprocess.Popen[str] | None = None
        try:
            assert plant.stderr is not None
            first = plant.stderr.readline()
            if not first.startswith("listening on "):
                raise StudyError(f"the plant did not start: {first}{plant.stderr.read()}"[:1000])
            host, port = first.split()[-1].split(":")
            if program is None:
                control = _started("control", str(file), "--connect", f"{host}:{port}", "--json")
            else:
                control = _started(host, port, str(Path(program).with_name("reference.bin")), program=(program,))
            said, errors = control.communicate()
            _, wrong = plant.communicate()
        finally:
            for process in (plant, control):
                if process is not None and process.poll() is None:
                    process.kill()
        if plant.returncode not in (0, 3) or control.returncode not in (0, 3):
            raise StudyError(f"plant: {wrong[-500:]} controller: {errors[-500:]}")
        return read(Trace.load(trace), json.loads(said), begun)


def _started(*words: str, program: Sequence[str] = (sys.executable, "-m", "moc_opt")) -> subprocess.Popen[str]:
    return subprocess.Popen([*program, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def read(trace: Trace, said: dict[str, Any], begun: str) -> Run:
    columns, wire, ended = trace.columns, trace.meta["wire"], str(trace.meta["ended"])
    rcm = float(np.max(trace.rcm_error_registered_m))
    rest = bool(np.abs(trace.v_rad_per_s[-1]).max() < AT_REST_RAD_PER_S)
    clean = ended == "completed" or (ended.startswith("stopped:") and rest and rcm < SAFE_RCM_M)
    system = {"plant": wire["system"], "controller": said["system"]}
    whole = "stopped_at_s" not in trace.meta
    cycles = len(trace) if whole else int(np.searchsorted(trace.t_s, float(trace.meta["stopped_at_s"]))) + 1
    wake, round_trip, control = (columns[name][:cycles] for name in ("wake_us", "tick_us", "control_us"))
    return Run(
        wake, round_trip, control, missed=int(columns["missed"][:cycles].sum()), overruns=int(wire["overruns"]),
        ended=ended, clean=clean, rcm_max_mm=1e3 * rcm, system=system, begun=begun,
    )  # fmt: skip


# --- table and goals ---


def summarise(runs: Sequence[Run]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "runs": len(runs), "cycles": sum(len(run.round_us) for run in runs), "missed": sum(run.missed for run in runs),
        "overruns": sum(run.overruns for run in runs), "stopped": sum(run.ended != "completed" for run in runs),
        "unclean": sum(not run.clean for run in runs), "rcm_max_mm": max(run.rcm_max_mm for run in runs),
    }  # fmt: skip
    found |= share(found["missed"], found["cycles"]).entries("missed_share")
    for time in TIMES:
        values = np.concatenate([getattr(run, f"{time}_us") for run in runs])
        values = values[np.isfinite(values)]  # NaN: cycles without an answer
        found |= {f"{time}_{name}_us": float(np.percentile(values, at)) for name, at in PERCENTILES.items()}
    return found


def _share(name: str, least: int) -> Callable[[Any], Interval | None]:
    """Return a function that gives a case's share of missed cycles, or None if it has fewer than ``least`` cycles."""

    def measured(summary: Any) -> Interval | None:
        found = summary["cases"][name]
        return share(found["missed"], found["cycles"]) if found["cycles"] >= least else None

    return measured


def _largest(load: str, metric: str) -> Callable[[Any], Any]:
    return lambda s: max(found[metric] for name, found in s["cases"].items() if name.endswith(load))


GOALS = {key: Goal(*given, section=DETAILS) for key, given in {
    "c": ("share of missed cycles (C, 500 Hz, no load)", "", 1e-5, _share("C, 500 Hz, quiet", 100_000)),
    "python": ("share of missed cycles (Python, 500 Hz, no load)", "", 1e-3, _share("Python, 500 Hz, quiet", 1_000)),
    "quiet stops": ("largest number of stopped runs in a case without load", "", 0.0, _largest("quiet", "stopped")),
    "rcm": ("largest RCM error (registered trocar) under load", "mm", 1e3 * SAFE_RCM_M,
            _largest("loaded", "rcm_max_mm")),
    "stops": ("largest number of unclean stops in a case under load", "", 0.0,
              lambda s: _largest("loaded", "unclean")(s) if _largest("loaded", "stopped")(s) else None),
}.items()}  # fmt: skip


# --- report ---


def sentences(summary: Mapping[str, Any]) -> list[str]:
    cases, said = summary["cases"], []
    quiet = {name: found for name, found in cases.items() if name.endswith("quiet")}
    if quiet:
        each = [f"{name.rpartition(', ')[0]} {found['missed']} of {found['cycles']:,}" for name, found in quiet.items()]
        stalled = sum(found["overruns"] for found in quiet.values())
        said.append(f"Cycles missed on a quiet machine: {'; '.join(each)}. {stalled} ticks began over one period late.")
    loaded = [found for name, found in cases.items() if name.endswith("loaded")]
    if loaded:
        keys = ("missed", "cycles", "stopped", "unclean")
        missed, cycles, stopped, unclean = (sum(found[key] for found in loaded) for key in keys)
        said.append(
            f"With every core busy, {missed} of {cycles:,} cycles were missed, the largest RCM error was "
            f"{max(found['rcm_max_mm'] for found in loaded):.2f} mm, and "
            f"{f'{unclean} of {stopped} stops were not clean' if stopped else 'no run was stopped'}."
        )
    return [*said, goals_sentence(summary["goals"])]


def report(summary: Mapping[str, Any], subject: str = "") -> Report:
    rows = []
    for name, found in summary["cases"].items():
        low, value, high = (1e5 * found[f"missed_share{end}"] for end in ("_low", "", "_high"))
        times = {time: " / ".join(f"{found[f'{time}_{p}_us']:,.0f}" for p in PERCENTILES) for time in TIMES}
        rows.append({**found, **times, "name": name, "in_100000": f"{value:.2g} [{low:.2g}, {high:.2g}]"})
    table = Table("Every case", [
        Column("name", "case"), Column("cycles", "cycles", format=",d"),
        Column("missed", "missed", format="d", help="cycles without a command in time"),
        Column("in_100000", "per 100,000", help="missed cycles, with the 95 % interval"),
        Column("overruns", "plant stalls", format="d", help="number of ticks that began more than a period late"),
        *(Column(time, title, unit="us") for time, title in TIMES.items()), Column("stopped", "stops", format="d"),
        Column("unclean", "not clean", format="d", help="stops with a large RCM error, or with moving joints"),
        Column("rcm_max_mm", "RCM error, worst", unit="mm", format=".2f"),
    ], rows)  # fmt: skip
    how = (
        "Quiet: the study starts nothing else. Loaded: one more process per core computes without a pause. The "
        "machine's load is read after the last case, as its one-minute average. Times are median / 99th percentile / "
        "99.99th percentile / longest. Brackets: 95 % interval.\n\nMissed: cycles without a command in time. Plant "
        "stalls: plant ticks that began more than a period late. Wake-up latency: how late a tick of the plant begins. "
        "Round trip: from the departure of a measurement to the arrival of its torque, over the loopback. Controller: "
        "the time of safety filter and control law. Clean: a run that was completed, or that ended at rest with an "
        "RCM error below 2 mm. Not clean: all other runs."
    )
    title, first = "Plant and controller against the clock", goals_table(summary["goals"])
    return Report(title, sentences(summary), first, (), [Section(DETAILS, how, [table])], subtitle=subject)


def options(parser: ArgumentParser) -> None:
    parser.add_argument("--cycles", type=int, metavar="N", help="cycles of every case, instead of the configuration's")


main = partial(command, "realtime", "Measure plant and controller against the clock.", Config, work, options=options)

if __name__ == "__main__":
    sys.exit(main())
