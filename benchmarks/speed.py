"""What does everything cost? All times side by side in one run: ticks, solvers, adapters, the loop, other libraries.

python -m benchmarks.speed [CONFIG.toml] [--out DIR] [--seed N] [--quick]
"""

from __future__ import annotations

import subprocess
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator

from benchmarks import baselines as peers
from benchmarks.common import cli
from benchmarks.common.config import Configuration, choose
from benchmarks.common.goals import verdicts
from benchmarks.latency import runs
from benchmarks.latency.bare import LIBRARIES
from benchmarks.latency.page import answer, report, tables, timed_rows
from benchmarks.latency.verdict import GOALS
from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.robots.model import load_robot
from moc_opt.scenario import Scenario
from moc_opt.study.timing import Disturbance, clock_cost_us

Count = Annotated[int, Field(ge=1)]
Names = Literal["all"] | list[str]


class Config(Configuration):
    """benchmarks/configs/speed.toml."""

    solvers: list[str] = Field(["exact", "daqp", "proxqp", "osqp"])
    ticks: int = Field(2000, ge=100)
    rounds: Count = 4
    batch: Count = 1_000_000
    adapters: Names = "all"
    runs: Count = 5
    processes: Count = 5
    peers: Names = "all"
    scenario: Scenario = Scenario()

    @field_validator("solvers")
    @classmethod
    def _with_exact(cls, value: list[str]) -> list[str]:
        if "exact" not in value:
            raise ValueError("'exact' must be among them: the others are compared with it")
        return value

    def quick(self) -> Self:
        few = {
            "ticks": min(self.ticks, 400), "rounds": 1, "batch": min(self.batch, 20_000), "runs": 1,
            "processes": 1, "scenario": self.scenario.change(duration_s=1.0),
        }  # fmt: skip
        return self.model_copy(update=few)


def measure(config: Config, step: runs.Step) -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, Array]]:
    """Measure all parts, one after the other.

    Returns:
        the summary, part -> name -> metric; rows of every chunk and round; times of the ticks [us] by name.

    Raises:
        UnknownNameError: a solver, an adapter or another library that does not exist, before anything is measured.
    """
    bench = runs.Bench()
    names, reasons = choose(config.solvers)
    bench.missing |= {f"solver {name}": reason for name, reason in reasons.items()}
    adapters, reasons = choose(_known("adapter", config.adapters, LIBRARIES))
    bench.missing |= {f"adapter {name}": reason for name, reason in reasons.items()}
    libraries = _known("peer", config.peers, peers.PEERS)
    # The loop alone: what judges its answers comes after it.
    scenario = config.scenario.change(seed=config.seed, judge=False, bound_samples=0)
    robot, rounds = load_robot(scenario.robot.name), config.rounds

    long = scenario.change(duration_s=config.ticks * scenario.plant.period_s)
    inputs, problems = runs.record(long)
    step("recorded a run")
    own, others, times = runs.ticks(bench, names, libraries, scenario, robot, inputs, rounds, step)
    step("whole ticks")
    try:
        own["c"] = runs.exported(scenario.change(duration_s=1.0))
    except (MocOptError, OSError, subprocess.SubprocessError) as error:
        bench.missing["exported C program"] = f"{type(error).__name__}: {error}"
    step("moc_step")
    summary: dict[str, Any] = {"tick": own, "peers": others}
    summary["tick_parts"] = runs.parts(bench, scenario, robot, inputs, rounds)
    step("parts of a tick")
    summary["batch"] = {"exact": runs.batch(problems, config.batch)}
    step("batch")
    summary["adapters"] = runs.adapters(bench, adapters, robot, problems, rounds)
    step("adapters")
    summary["loop"] = runs.loop(bench, scenario, config.runs, own.get("c", {}).get("tick_p50_us"), step)
    summary["setup"] = runs.fresh(bench, config.processes, step)
    summary["clock"] = {"cost": {"p50_us": clock_cost_us()}}
    summary["not_run"] = {name: {"reason": reason} for name, reason in bench.missing.items()}
    summary["goals"] = verdicts(summary, GOALS)
    return summary, bench.rows, times


def _known(kind: str, wanted: Names, all_of_them: Mapping[str, Any]) -> list[str]:
    names = list(all_of_them) if wanted == "all" else list(wanted)
    for name in names:
        if name not in all_of_them:
            raise UnknownNameError(kind, name, all_of_them)
    return names


def study(given: Namespace) -> cli.Results:
    config = Config.chosen(given, "speed")
    many = len(peers.PEERS) if config.peers == "all" else len(config.peers)
    with cli.steps("speed", 6 + many + 1 + config.runs + 2 * config.processes) as step:
        summary, rows, times = measure(config, step)
    environment = config.environment(given, load=Disturbance.total(timed_rows(summary)).told())
    first, shown = answer(summary, times), tables(summary)
    return cli.Results(
        summary, environment, rows, report(summary, first, environment), [shown["tick"], shown["peers"]], answer=first
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    return cli.run(cli.parser("speed", "Measure what everything costs."), study, arguments)


if __name__ == "__main__":
    sys.exit(main())
