"""Plant and controller as two processes against the clock: how late each wakes up, what a round trip takes, who misses.

python -m benchmarks.realtime [CONFIG.toml] [--cycles N] [--out DIR] [--seed N] [--quick]

Run it alone: everything else on the machine is in its figures.
"""

from __future__ import annotations

import os
import sys
import tempfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from pydantic import Field

from benchmarks import cli
from benchmarks.config import Configuration
from benchmarks.latency import wire
from benchmarks.latency.goals import Goal, goal_verdicts
from benchmarks.latency.report import GOALS as GOAL_COLUMNS
from benchmarks.latency.wire import Case, Found
from moc_opt.report import figures
from moc_opt.report.figures.style import Styles, figure, legend_height, log_axis, rule
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario

Array = NDArray[np.float64]
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99_99": 99.99, "worst": 100.0}
TIMES = {"wake": "wake-up latency", "round": "round trip", "control": "controller"}
BINS = 120


class Config(Configuration):
    """benchmarks/configs/realtime.toml."""

    cycles: int = Field(100_000, ge=100, description="of every case")
    run_cycles: int = Field(20_000, ge=100, description="of one run")
    rates_Hz: list[Literal[250, 500, 1000]] = Field([500, 1000], min_length=1)
    controllers: list[Literal["python", "c"]] = Field(["python", "c"], min_length=1)
    loads: list[Literal["quiet", "loaded"]] = Field(["quiet", "loaded"], min_length=1)
    scenario: Scenario = Scenario(judge=False, bound_samples=0)

    def quick(self) -> Self:
        """Return the same on less data."""
        return self.model_copy(update={"cycles": 1000, "run_cycles": 1000, "rates_Hz": self.rates_Hz[:1]})

    def cases(self) -> list[Case]:
        """Return every controller at every rate under every load."""
        return [Case(c, rate, load) for rate in self.rates_Hz for load in self.loads for c in self.controllers]


def _share(name: str, least: int) -> Any:
    """The share of missed cycles of a case; LookupError where there were too few to tell."""

    def measured(summary: Any) -> float:
        found = summary["cases"][name]
        if found["cycles"] < least:
            raise LookupError(f"{found['cycles']} cycles")
        return float(found["missed_share"])

    return measured


def _loaded(metric: str) -> Any:
    return lambda s: max(found[metric] for name, found in s["cases"].items() if name.endswith("loaded"))


GOALS = {
    "c": Goal("share of cycles missed, C, 500 Hz, quiet", "", 1e-5, True, _share("c, 500 Hz, quiet", 100_000)),
    "python": Goal("share of cycles missed, Python, 500 Hz, quiet", "", 1e-3, True,
                   _share("python, 500 Hz, quiet", 1_000)),
    "rcm": Goal("largest RCM error from the registered trocar, under load", "mm", 1e3 * wire.SAFE_RCM_M, True,
                _loaded("rcm_max_mm")),
    "stops": Goal("stops that were not clean, under load", "", 0.0, True, _loaded("unclean")),
}  # fmt: skip

COLUMNS = [
    Column("name", "case"), Column("cycles", "cycles", format="d"), Column("missed", "missed", format="d"),
    Column("overruns", "plant stalled", format="d", help="the plant's own process was not run for a period"),
    Column("stopped", "stops", format="d"), Column("unclean", "not clean", format="d"),
    Column("rcm_max_mm", "RCM", unit="mm", format=".2f", help="largest error from the registered trocar"),
    *(Column(f"{time}_{p}_us", f"{title} {p.replace('_', '.')}", unit="us", format=".0f", better="low")
      for time, title in TIMES.items() for p in PERCENTILES),
]  # fmt: skip


def summarise(runs: Sequence[Found]) -> dict[str, Any]:
    """Return the figures of a case's runs."""
    found: dict[str, Any] = {
        "runs": len(runs), "cycles": sum(len(run.round_us) for run in runs), "missed": sum(run.missed for run in runs),
        "overruns": sum(run.overruns for run in runs), "stopped": sum(run.ended != "completed" for run in runs),
        "unclean": sum(not run.clean for run in runs), "rcm_max_mm": max(run.rcm_max_mm for run in runs),
    }  # fmt: skip
    found["missed_share"] = found["missed"] / found["cycles"]
    for time in TIMES:
        values = samples(runs, time)
        found |= {f"{time}_{name}_us": float(np.percentile(values, at)) for name, at in PERCENTILES.items()}
    return found


def samples(runs: Sequence[Found], time: str) -> Array:
    """Return the times of all cycles [us], but for those without one."""
    values = np.concatenate([getattr(run, f"{time}_us") for run in runs])
    return values[np.isfinite(values)]


def histogram(times: Mapping[str, Array], deadline_us: float | None = None) -> go.Figure:
    """Draw how many cycles took how long, both axes logarithmic: one late cycle of a million is seen."""
    drawn, styles = figure(legend_y=1.08, height=320 + legend_height(times)), Styles(times)
    ends = np.concatenate([np.maximum(values, 1.0)[[values.argmin(), values.argmax()]] for values in times.values()])
    edges = np.geomspace(0.95 * ends.min(), 1.05 * ends.max(), BINS + 1)
    for name, values in times.items():
        counts = np.histogram(np.maximum(values, 1.0), edges)[0]
        drawn.add_scatter(
            x=np.sqrt(edges[1:] * edges[:-1]), y=np.where(counts > 0, counts, np.nan), name=name, mode="lines+markers",
            line={"color": styles[name].color, "shape": "hvh", "width": 1.4}, marker={"size": 3}, connectgaps=False,
        )  # fmt: skip
    log_axis(drawn, "x", "time [us]", edges if deadline_us is None else [*edges, deadline_us])
    log_axis(drawn, "y", "cycles", [0.8, max(len(values) for values in times.values())], powers=True)
    if deadline_us is not None:
        rule(drawn, "x", deadline_us, "deadline")
    return drawn


def tables(summary: Mapping[str, Any]) -> list[Table]:
    """Return goals and figures."""
    goals = [{**of, "goal": f"{of['goal']:g}", "value": _short(of["value"])} for of in summary["goals"].values()]
    rows = [{"name": name, **found} for name, found in summary["cases"].items()]
    return [Table("Goals", GOAL_COLUMNS, goals), Table("Against the clock", COLUMNS, rows)]


def report(summary: Mapping[str, Any], runs: Mapping[Case, Sequence[Found]], environment: Mapping[str, Any]) -> Page:
    """Make the page."""
    page = Page("Against the clock", "plant and controller as two processes with a UDP wire between them")
    page.headline(headline(summary))
    page.text(
        "Wake-up latency: how late the plant's tick begins. Round trip: from the departure of a measurement to the "
        "arrival of its torque, over the loopback; a cycle is missed where that takes longer than the period. "
        "Controller: safety filter and control law alone. `environment` says which priority, memory and timers the two "
        "processes were granted; Python's collector is off inside both loops."
    )
    for table in tables(summary):
        page.table(table)
    for rate in sorted({case.rate_Hz for case in runs}):
        page.section(f"{rate} Hz")
        for time, title in TIMES.items():
            of = {f"{c.controller}, {c.load}": samples(found, time) for c, found in runs.items() if c.rate_Hz == rate}
            deadline = 1e6 / rate if time == "round" else None
            page.figure(histogram(of, deadline), f"{title} at {rate} Hz: how many cycles took how long.",
                        name=f"{time}-{rate}")  # fmt: skip
            if time == "round":
                tail = figures.latency_ecdf(of, deadline, tail=True)
                page.figure(tail, f"{title} at {rate} Hz: the rare late ones.", name=f"tail-{rate}")
    page.environment(environment)
    return page


def headline(summary: Mapping[str, Any]) -> str:
    """Return the result in words, computed."""
    said = [
        f"{name}: {found['missed']} of {found['cycles']} cycles missed, round trip {found['round_p50_us']:.0f} us "
        f"(median), {found['round_worst_us']:.0f} us at worst"
        for name, found in summary["cases"].items()
    ]
    return ". ".join(part[0].upper() + part[1:] for part in said) + "."


def _short(value: float | None) -> str | None:
    return None if value is None else f"{value:.3g}"


def study(given: Namespace) -> cli.Results:
    """Measure every case."""
    config = Config.chosen(given, "realtime")
    if given.cycles is not None:
        config = Config(**config.model_dump() | {"cycles": given.cycles})
    each = min(config.cycles, config.run_cycles)
    runs: dict[Case, list[Found]] = {}
    cases = config.cases()
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder, cli.steps("realtime", len(cases)) as step:
        for rate in config.rates_Hz:
            file, program = Path(folder, f"{rate}.toml"), None
            file.write_text(wire.scenario_text(config.scenario, rate, each, config.seed), encoding="utf-8")
            if "c" in config.controllers:
                program = wire.build(file, Path(folder, f"c{rate}"))
            for case in (case for case in cases if case.rate_Hz == rate):
                limit = each / rate + wire.SPARE_S
                most = 3 * -(-config.cycles // each)
                own = program if case.controller == "c" else None
                runs[case] = wire.measure(case, file, own, config.cycles, most, limit)
                step(str(case))
    summary: dict[str, Any] = {"cases": {str(case): summarise(found) for case, found in runs.items()}}
    summary["goals"] = goal_verdicts(summary, GOALS)
    rows = [
        {"case": str(case), "run": k, "cycles": len(run.round_us), "missed": run.missed, "overruns": run.overruns,
         "ended": run.ended, "clean": run.clean, "rcm_max_mm": run.rcm_max_mm,
         "round_worst_us": float(run.round_us.max()), "wake_worst_us": float(run.wake_us.max())}
        for case, found in runs.items() for k, run in enumerate(found)
    ]  # fmt: skip
    system = {str(case): found[0].system for case, found in runs.items()}
    environment = config.environment(given, system=system, collector="off inside both loops", cores=os.cpu_count())
    page = report(summary, runs, environment)
    return cli.Results(summary, environment, rows, page, tables(summary), [headline(summary)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("realtime", "Measure plant and controller against the clock.")
    options.add_argument("--cycles", type=int, metavar="N", help="of every case, in place of the configuration's")
    return cli.run(options, study, arguments)


if __name__ == "__main__":
    sys.exit(main())
