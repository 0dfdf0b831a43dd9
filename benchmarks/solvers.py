"""The main job: every solver on the same recorded subproblems, and in the same torque controller.

python -m benchmarks.solvers [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--only NAME ...]
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from benchmarks import closed_loop, open_loop, output
from benchmarks.solvers_report import print_tables, write_report
from benchmarks.timing import clock_cost_us
from moc_opt.errors import MocOptError, ScenarioError, UnknownNameError
from moc_opt.model import RobotModel, load_robot
from moc_opt.report.console import console, progress
from moc_opt.scenario import Scenario, make_solver
from moc_opt.settings import Settings
from moc_opt.solvers import available
from moc_opt.subproblem import NullSpaceQP


class OpenLoop(Settings):
    """The recorded sequence."""

    KIND: ClassVar[str] = "[open_loop]"
    task: str = "circle"
    ticks: int = Field(2000, ge=2)
    cold: int = Field(100, ge=1)


class ClosedLoop(Settings):
    """The trials."""

    KIND: ClassVar[str] = "[closed_loop]"
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    seeds: int = Field(1, ge=1)
    duration_s: float | None = Field(None, gt=0.0)


class Config(Settings):
    """benchmarks/configs/solvers.toml."""

    KIND: ClassVar[str] = "configuration:"
    seed: int = Field(0, ge=0)
    solvers: Literal["all"] | list[str] = "all"
    open_loop: OpenLoop = OpenLoop()
    closed_loop: ClosedLoop = ClosedLoop()
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict, description="per solver")
    scenario: Scenario = Scenario()

    @classmethod
    def load(cls, path: Path) -> Config:
        """Read a TOML file; errors name file and field."""
        try:
            return cls(**tomllib.loads(path.read_text(encoding="utf-8")))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ScenarioError(f"{path}: cannot be used as a configuration: {error}") from error

    def quick(self) -> Config:
        """The same comparison on less data: for a first look and for the tests."""
        return self.model_copy(
            update={
                "open_loop": self.open_loop.model_copy(update={"ticks": 200, "cold": 10}),
                "closed_loop": self.closed_loop.model_copy(
                    update={"tasks": self.closed_loop.tasks[:1], "seeds": 1, "duration_s": 1.5}
                ),
            }
        )


def choose(wanted: Literal["all"] | list[str]) -> tuple[list[str], dict[str, str]]:
    """Names that can run here, and name -> reason for those that cannot.

    Raises:
        UnknownNameError: a name that no solver has.
    """
    found = available()
    names = list(found) if wanted == "all" else wanted
    for name in names:
        if name not in found:
            raise UnknownNameError("solver", name, found)
    reasons = {name: reason for name in names if (reason := found[name]) is not None}
    return [name for name in names if name not in reasons], reasons


def record(config: Config) -> list[NullSpaceQP]:
    """The sequence of the open-loop part, from a closed-loop run with ``exact``."""
    cut = config.open_loop.ticks * config.scenario.plant.period_s
    case = next(iter(closed_loop.trials(config.scenario, [config.open_loop.task], [config.seed]).values()))
    problems = open_loop.record(case.change(duration_s=cut))
    open_loop.expand(problems)
    return problems


def run_open_loop(
    config: Config, names: list[str], robot: RobotModel, problems: list[NullSpaceQP], advance: Any
) -> tuple[list[open_loop.Answers], dict[str, str]]:
    """Every solver warm and cold; name -> reason for those that do not take these problems."""
    answers, refused = [], {}
    every = max(1, len(problems) // config.open_loop.cold)
    for name in names:
        solver = make_solver(name, robot, **config.settings.get(name, {}))
        reason = solver.supports(problems[0])
        if reason is None:
            answers.append(open_loop.solve_all(name, solver, problems, warm=True))
            advance(f"open loop {name}, warm")
            answers.append(open_loop.solve_all(name, solver, problems, warm=False, every=every))
        else:
            refused[name] = reason
            advance(name)
        advance(f"open loop {name}, cold")
    return answers, refused


def run_closed_loop(config: Config, names: list[str], advance: Any) -> list[closed_loop.Run]:
    """Every solver in the controller, and the baseline, on every trial."""
    part = config.closed_loop
    seeds = [config.seed + i for i in range(part.seeds)]
    cases = closed_loop.trials(config.scenario.change(duration_s=part.duration_s), part.tasks, seeds)
    return closed_loop.run_all(cases, {name: config.settings.get(name, {}) for name in names}, advance)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; 0, or 2 with a message where the input is wrong."""
    options = output.parser("solvers", "Compare the solvers, open loop and in closed loop.")
    options.add_argument("--only", nargs="+", metavar="NAME", help="these solvers alone")
    given = options.parse_args(arguments)
    try:
        config = Config.load(given.config or output.default_config("solvers"))
        if given.seed is not None:
            config = config.model_copy(update={"seed": given.seed})
        if given.quick:
            config = config.quick()
        names, missing = choose(given.only or config.solvers)
        compare(config, names, missing, given.out, given.json, list(arguments or sys.argv[1:]))
    except MocOptError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    return 0


def compare(
    config: Config, names: list[str], missing: dict[str, str], out: Path, as_json: bool, argv: list[str]
) -> dict[str, Any]:
    """Both parts, all files; returns the summary."""
    robot = load_robot(config.scenario.robot.name)
    trial_count = len(config.closed_loop.tasks) * config.closed_loop.seeds
    with progress("solvers", 1 + 2 * len(names) + (1 + len(names)) * trial_count) as bar:

        def advance(text: str) -> None:
            bar.at(text)
            bar.advance()

        problems = record(config)
        advance("recorded the sequence")
        answers, refused = run_open_loop(config, names, robot, problems, advance)
        runs = run_closed_loop(config, [name for name in names if name not in refused], advance)
    missing = {**missing, **refused}
    summary: dict[str, Any] = {
        part: {a.solver: a.summary() for a in answers if f"open_loop_{a.mode}" == part}
        for part in ("open_loop_warm", "open_loop_cold")
    }
    summary["closed_loop"] = closed_loop.summary(runs)
    summary["not_run"] = {name: {"reason": reason} for name, reason in missing.items()}
    summary["clock"] = {"cost": {"p50_us": clock_cost_us()}}

    environment = output.environment(config.model_dump(mode="json"), config.seed, argv)
    output.write_json(out / "summary.json", summary)
    output.write_rows(
        out / "rows.parquet", [row for a in answers for row in a.rows()] + [run.row() for run in runs]
    )
    output.write_json(out / "environment.json", environment)
    np.save(out / "sequence.npy", np.array([qp.row for qp in problems]))
    write_report(out / "report.html", summary, answers, runs, environment, config.scenario.deadline_us)
    if as_json:
        print((out / "summary.json").read_text(), end="")
    else:
        print_tables(console(), summary, out)
    return summary


if __name__ == "__main__":
    sys.exit(main())
