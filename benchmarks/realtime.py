"""Plant and controller as two processes against the clock: how late each wakes up, what a round trip takes, who misses.

python -m benchmarks.realtime [CONFIG.toml] [--cycles N] [--out DIR] [--seed N] [--quick] [--page]

Run it alone: everything else on the machine is in its figures. A run that is done is kept in DIR/jobs: the same command
goes on where it was broken off, on the same machine. --page also writes the table into
docs/realtime.md.
"""

from __future__ import annotations

import os
import sys
import tempfile
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration
from benchmarks.common.goals import Goal, verdicts
from benchmarks.common.markdown import write_section
from benchmarks.common.output import default_config
from benchmarks.latency import clock, wire
from benchmarks.latency.wire import Case, Found
from moc_opt.errors import MocOptError
from moc_opt.scenario import Scenario
from moc_opt.study.kept import Kept, key_of, loaded_sources
from moc_opt.study.statistics import Interval, share


class Config(Configuration):
    """benchmarks/configs/realtime.toml."""

    cycles: int = Field(100_000, ge=100, description="of every case")
    run_cycles: int = Field(20_000, ge=100, description="of one run")
    rates_Hz: list[Literal[250, 500, 1000]] = Field([500, 1000], min_length=1)
    controllers: list[Literal["python", "c"]] = Field(["python", "c"], min_length=1)
    loads: list[Literal["quiet", "loaded"]] = Field(["quiet", "loaded"], min_length=1)
    scenario: Scenario = Scenario(judge=False, bound_samples=0)

    def quick(self) -> Self:
        return self.model_copy(update={"cycles": 1000, "run_cycles": 1000, "rates_Hz": self.rates_Hz[:1]})

    def cases(self) -> list[Case]:
        """Return every controller at every rate under every load."""
        return [
            Case(c, rate, load) for rate in self.rates_Hz for load in self.loads for c in self.controllers
        ]


def _share(name: str, least: int) -> Any:
    """Return the share of missed cycles of a case; LookupError where there were too few to tell."""

    def measured(summary: Any) -> Interval:
        found = summary["cases"][name]
        if found["cycles"] < least:
            raise LookupError(f"{found['cycles']} cycles")
        return share(found["missed"], found["cycles"])

    return measured


def _largest(load: str, metric: str) -> Any:
    return lambda s: max(found[metric] for name, found in s["cases"].items() if name.endswith(load))


_GOALS = {
    "c": ("share of cycles missed, C, 500 Hz, quiet", "", 1e-5, _share("c, 500 Hz, quiet", 100_000)),
    "python": ("share of cycles missed, Python, 500 Hz, quiet", "", 1e-3, _share("python, 500 Hz, quiet", 1_000)),
    "quiet stops": ("runs that were stopped, on a quiet machine", "", 0.0, _largest("quiet", "stopped")),
    "rcm": ("largest RCM error from the registered trocar, under load", "mm", 1e3 * wire.SAFE_RCM_M,
            _largest("loaded", "rcm_max_mm")),
    "stops": ("stops that were not clean, under load", "", 0.0, _largest("loaded", "unclean")),
}  # fmt: skip
GOALS = {key: Goal(*given, section=clock.DETAILS) for key, given in _GOALS.items()}


def runs_of(config: Config, folder: Path, kept: Kept, machine: dict[str, Any]) -> dict[Case, list[Found]]:
    """Do the runs of every case, those of an earlier command excepted.

    They are started from this process: the plant's clock needs the machine for itself.
    """
    found: dict[Case, list[Found]] = {}
    each, cases = min(config.cycles, config.run_cycles), config.cases()
    most = 3 * -(-config.cycles // each)
    with cli.steps("realtime", len(cases)) as step:
        for rate in config.rates_Hz:
            file = folder / f"{rate}.toml"
            wire.run_of(config.scenario, rate, each, config.seed).save(file)
            program = wire.build(file, folder / f"c{rate}") if "c" in config.controllers else None
            for case in (case for case in cases if case.rate_Hz == rate):
                runs = found[case] = []
                while sum(len(run.round_us) for run in runs) < config.cycles and len(runs) < most:
                    about = [str(case), file.read_text(encoding="utf-8"), machine, len(runs)]
                    key = key_of(wire.run_once, about)
                    if (earlier := kept.get(key)) is not None:
                        runs.append(earlier[0])
                        continue
                    own = program if case.controller == "c" else None
                    runs.append(wire.run_once(case, file, own, each / rate + wire.SPARE_S))
                    kept.put(key, runs[-1], loaded_sources())
                step(str(case))
    return found


def summarise(runs: Sequence[Found]) -> dict[str, Any]:
    """Return the figures of a case's runs."""
    found: dict[str, Any] = {
        "runs": len(runs), "cycles": sum(len(run.round_us) for run in runs), "missed": sum(run.missed for run in runs),
        "overruns": sum(run.overruns for run in runs), "stopped": sum(run.ended != "completed" for run in runs),
        "unclean": sum(not run.clean for run in runs), "rcm_max_mm": max(run.rcm_max_mm for run in runs),
    }  # fmt: skip
    found |= share(found["missed"], found["cycles"]).entries("missed_share")
    for time in clock.TIMES:
        values = clock.samples(runs, time)
        found |= {f"{time}_{name}_us": float(np.percentile(values, at)) for name, at in clock.PERCENTILES.items()}
    return found


def check_page(config: Config) -> None:
    """Refuse to write the page from another configuration than the one that ships; the cycles are shown with it.

    Raises:
        MocOptError: it is another one.
    """
    shipped = Config.load(default_config("realtime"))
    if config.model_copy(update={"cycles": shipped.cycles}) != shipped:
        raise MocOptError("--page: the page shows runs of the configuration that ships: give --cycles alone")


def study(given: Namespace) -> cli.Results:
    config = Config.chosen(given, "realtime")
    if given.cycles is not None:
        config = Config(**config.model_dump() | {"cycles": given.cycles})
    if given.page:
        check_page(config)
    environment = config.environment(given, collector="off inside both loops", cores=os.cpu_count())
    machine = {"processor": environment["machine"]["processor"], "cores": os.cpu_count()}
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder:
        runs = runs_of(config, Path(folder), Kept(given.out / "jobs"), machine)
    summary: dict[str, Any] = {"cases": {str(case): summarise(found) for case, found in runs.items()}}
    summary["goals"] = verdicts(summary, GOALS)
    rows = [
        {"case": str(case), "run": k, "begun": run.begun, "cycles": len(run.round_us), "missed": run.missed,
         "overruns": run.overruns, "ended": run.ended, "clean": run.clean, "rcm_max_mm": run.rcm_max_mm,
         "round_worst_us": float(run.round_us.max()), "wake_worst_us": float(run.wake_us.max())}
        for case, found in runs.items() for k, run in enumerate(found)
    ]  # fmt: skip
    environment |= {"system": {str(case): found[0].system for case, found in runs.items()}}
    if given.page:
        write_section(clock.PAGE, clock.SECTION, clock.page_text(summary, environment))
    first = clock.answer(summary, runs)
    return cli.Results(summary, environment, rows, clock.report(summary, GOALS, runs, first, environment), answer=first)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("realtime", "Measure plant and controller against the clock.")
    options.add_argument(
        "--cycles", type=int, metavar="N", help="of every case, in place of the configuration's"
    )
    options.add_argument("--page", action="store_true", help="write the table into docs/realtime.md")
    return cli.run(options, study, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
