"""The command of a study.

    class Config(StudyConfig): ...
    def work(study: Study, config: Config) -> Found: ...
    def main(arguments=None): return command("robots", "What holds on every arm.", Config, work, arguments)

After an interruption, the same command continues from the finished jobs.
"""

from __future__ import annotations

import datetime
import os
import platform
import re
import signal
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, TypeVar

from pydantic import Field

from moc_opt.errors import MocOptError, ScenarioError, SolverError, StudyError, UnknownNameError, named
from moc_opt.inputs.files import read_toml, to_json, write_whole
from moc_opt.inputs.settings import Settings
from moc_opt.report.console import Bar, console, divert_output, print_json
from moc_opt.scenario import Scenario
from moc_opt.solvers import available
from moc_opt.study.engine import Failed, Job, run
from moc_opt.study.kept import Kept, versions
from moc_opt.study.results import Results
from moc_opt.study.show import Report
from moc_opt.study.trials import Run, Trial, outcome, placed
from moc_opt.trace.meta import Ending

QUICK = "Quick run on less data: the full study may find something else."
WRONG, INTERRUPTED = 2, 130  # exit status after an error, and after Ctrl-C
FILES = ("environment.json", "summary.json", "rows.parquet", "report.html", "report.md")
CONFIGS = Path(__file__).parents[2] / "benchmarks" / "configs"


class StudyConfig(Settings):
    """Base of a study's configuration."""

    KIND: ClassVar[str] = "configuration:"
    seed: int = Field(0, ge=0, le=2**62)
    processes: int | None = Field(None, ge=1, description="number of parallel untimed jobs; None: one per core")

    @classmethod
    def load(cls, path: Path, seed: int | None = None) -> Self:
        """Read a TOML file. A given ``seed`` replaces the file's seed."""
        table = read_toml(path, "configuration", ScenarioError)
        with named(f"{path}:"):
            return cls(**table if seed is None else {**table, "seed": seed})

    def quick(self) -> Self:
        """Return the configuration for ``--quick``."""
        return self


Config = TypeVar("Config", bound=StudyConfig)


@dataclass(frozen=True)
class Found:
    """What a study found. ``summary[part][solver or controller][metric]`` is written to summary.json."""

    report: Report
    summary: Mapping[str, Any]
    rows: Results = field(default_factory=Results)
    environment: Mapping[str, Any] = field(default_factory=dict)  #: further entries of environment.json
    files: Sequence[str] = ()  #: names of further files
    sentences: Sequence[str] = ()  #: printed below the report
    status: int = 0  #: exit status


@dataclass(frozen=True)
class Study:
    """Runs the jobs of a study."""

    name: str
    out: Path  #: folder of the results
    given: Namespace  #: the parsed command line
    processes: int | None = None  #: number of parallel jobs; None: one per core

    @cached_property
    def kept(self) -> Kept:
        """The store of finished jobs."""
        return Kept(self.out / "jobs")

    def run(
        self, jobs: Sequence[Job], what: str = "jobs", *, done: Callable[[Job, Any], None] = lambda job, result: None,
        **options: Any,
    ) -> list[Any]:  # fmt: skip
        """Run jobs, and store their results."""
        with Bar(f"{self.name}: {what}", len(jobs)) as bar:

            def note(job: Job, result: Any) -> None:
                bar.step(job.group)
                done(job, result)

            dask = getattr(self.given, "dask", None)
            return run(jobs, kept=self.kept, workers=self.processes, dask=dask, done=note, **options)

    def trials(
        self, asked: Sequence[Trial], what: str = "runs", *, limit_s: float | None = None, **options: Any
    ) -> list[Run]:
        """Return one `Run` per trial, failed or not. ``limit_s`` replaces the trials' time limits."""
        jobs = [one.job if limit_s is None else replace(one.job, limit_s=limit_s) for one in asked]
        options.setdefault("keep", lambda run: run.row["ended"] != Ending.FAILED.value)  # failed runs are tried again
        results = self.run(jobs, what, **options)
        return [outcome(one, result) for one, result in zip(asked, results, strict=True)]

    def placed(self, cases: Sequence[Scenario]) -> tuple[list[Scenario], list[dict[str, Any]]]:
        """Find the start poses. Return the trials with a start pose, and a row for each trial without one."""
        found = self.run([Job(placed, (case,)) for case in cases], "starts")
        lost = [
            {**Trial(case, "").failed(str(start)).row, "ended": "no start"}
            for case, start in zip(cases, found, strict=True) if isinstance(start, Failed)
        ]  # fmt: skip
        return [start for start in found if not isinstance(start, Failed)], lost


def command(
    name: str, about: str, config: type[Config], work: Callable[[Study, Config], Found],
    arguments: Sequence[str] | None = None, *, options: Callable[[ArgumentParser], Any] = lambda parser: None,
    folder: Path | None = None, program: str = "",
) -> int:  # fmt: skip
    """Parse the command line, run the study, write and print its results, and return the exit status.

    ``config`` is read from NAME.toml in ``folder`` (default: benchmarks/configs). ``options`` can extend the parser.
    The exit status is `Found.status`, 2 after an error, or 130 after Ctrl-C or SIGTERM.
    """
    parser = ArgumentParser(prog=program or f"python -m benchmarks.{name}", description=about)
    parser.add_argument("config", nargs="?", type=Path, help=f"TOML file with the settings; default: {name}.toml")
    parser.add_argument("--out", type=Path, default=Path("results") / name, help="folder for the results")
    parser.add_argument("--seed", type=int, help="seed of random numbers; it replaces the file's seed")
    parser.add_argument("--quick", action="store_true", help="run the same study on less data")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON instead of text")
    parser.add_argument("--dask", metavar="ADDRESS", help="Dask scheduler for the jobs that are not timed")
    options(parser)
    given = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        asked = config.load(given.config or (folder or CONFIGS) / f"{name}.toml", given.seed)
        asked = asked.quick() if given.quick else asked
        study = Study(name, given.out, given, asked.processes)
        check_folder(given.out, name)
        with divert_output(given.json):
            found = work(study, asked)
            if given.quick:
                found = replace(found, report=replace(found.report, answer=[QUICK, *found.report.answer]))
            leave(found, study, asked, sys.argv[1:] if arguments is None else arguments)
        return found.status
    except (MocOptError, OSError) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return WRONG
    except KeyboardInterrupt:
        print(f"stopped. Finished jobs are in {given.out}/jobs. The same command continues from them.", file=sys.stderr)
        return INTERRUPTED


def check_folder(out: Path, name: str) -> None:
    """Raise a StudyError if the folder has files named as in `FILES` that another study or program has written."""
    there = [file for file in FILES if (out / file).exists()]
    mine = f'"study": "{name}"'.encode()
    if there and not (there[0] == FILES[0] and mine in (out / FILES[0]).read_bytes()):
        raise StudyError(f"{out} has files that this study has not written ({', '.join(there)}): give another --out")


def leave(found: Found, study: Study, config: StudyConfig, argv: Sequence[str]) -> None:
    """Write the files of a study, and print its report or, with ``--json``, its summary."""
    out = study.out
    out.mkdir(parents=True, exist_ok=True)
    surroundings = environment(config.model_dump(mode="json"), config.seed, argv)
    surroundings |= {"study": study.name, "jobs_of_an_earlier_run": study.kept.reused, **found.environment}
    for name, value in (("environment", surroundings), ("summary", found.summary)):
        write_whole(out / f"{name}.json", to_json(value, sort_keys=True) + "\n", "file of results", StudyError)
    found.rows.write(out / "rows.parquet")
    found.report.page(surroundings, found.rows.failed()).save(out / "report.html")
    write_whole(out / "report.md", found.report.markdown(), "report", StudyError)
    if study.given.json:
        print_json(found.summary, sort_keys=True)
        return
    screen = console()
    for part in found.report.screens():
        screen.print(part, markup=False)
    if study.kept.reused:
        screen.print(f"{study.kept.reused} jobs were not run again: {out}/jobs has their results.", soft_wrap=True)
    for sentence in found.sentences:
        screen.print(sentence, markup=False, soft_wrap=True)
    screen.print(f"written: {out}/{' '.join([*reversed(FILES), *found.files])}", markup=False, soft_wrap=True)


def environment(config: Mapping[str, Any], seed: int, argv: Sequence[str] = ()) -> dict[str, Any]:
    """Return the content of environment.json."""
    cpu = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", cpu.read_text()) if cpu.exists() else None
    return {
        "when": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "machine": {
            "system": platform.platform(), "cores": os.cpu_count(),
            "processor": model[1] if model else platform.processor(),
            "python": platform.python_version(), "load_1min": os.getloadavg()[0],
        },
        "threads": os.environ.get("OMP_NUM_THREADS"),
        "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE"),  # rounding errors depend on it
        "versions": versions(), "commit": _commit(), "seed": seed, "arguments": list(argv), "config": dict(config),
    }  # fmt: skip


def choose(wanted: Literal["all"] | Sequence[str], *beside: str) -> tuple[list[str], dict[str, str]]:
    """Return the wanted solvers that can run here, and the reasons why the others cannot.

    ``beside`` are accepted names that are no solvers, such as those of controllers without a solver.
    """
    found: dict[str, str | None] = {**dict.fromkeys(beside), **available()}
    names = list(found) if wanted == "all" else list(wanted)
    for name in names:
        if name not in found:
            raise UnknownNameError("solver", name, found, "moc-opt solvers --list")
    reasons = {name: reason for name in names if (reason := found[name]) is not None}
    return [name for name in names if name not in reasons], reasons


def runnable(wanted: Sequence[str], *beside: str) -> list[str]:
    """Return the wanted names. Raise a SolverError if one of the solvers cannot run here."""
    names, reasons = choose(wanted, *beside)
    if reasons:
        name, reason = next(iter(reasons.items()))
        raise SolverError(f"solver {name!r} cannot run here: {reason}")
    return names


def _commit() -> str | None:
    order = ["git", "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+changes"]
    try:
        done = subprocess.run(order, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
