"""The study of the solvers: on recorded problems, on problems with certified optima, and in closed loop."""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator

from moc_opt.arrays import Array
from moc_opt.errors import StudyError
from moc_opt.inputs.settings import Level, Settings
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.report.console import console
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study import testsets
from moc_opt.study.command import Found, Study, StudyConfig, choose, command
from moc_opt.study.engine import Failed, Job
from moc_opt.study.results import Results
from moc_opt.study.show import Report, Section
from moc_opt.study.solver_answers import Limits
from moc_opt.study.solver_parts import SOLVER, certified_sets, closed_loop, record, recorded_sequence
from moc_opt.study.solver_settings import QPSOLVERS, SolverSetting, solver_settings
from moc_opt.study.solver_verdicts import assess, first_table, pictures, sentences
from moc_opt.study.timing import clock_cost_us, each_us, load, total
from moc_opt.study.trials import BASELINE, seeds, trials

STREAM = 3
FULL = Path(__file__).parent / "solvers-full.toml"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
TIMED = ("open_loop_warm", "testsets", "closed_loop")  # sections of the summary that have times


class OpenLoop(Settings):
    """Settings of the recorded sequence: the subproblems of successive ticks of one closed-loop run."""

    KIND: ClassVar[str] = "[open_loop]"
    task: str = "circle"
    ticks: int = Field(500, ge=2)
    cold: int = Field(50, ge=1)


class TestSets(Limits):
    """Settings of the certified test sets."""

    __test__: ClassVar[bool] = False  # tells pytest that this is no test class

    names: Literal["all"] | list[str] = "all"
    timed: list[str] = Field(["circle", "circle-rho0", "random"], description="sets timed under every setting")
    timed_too: list[str] = Field(["infeasible", "joint-limits", "jumps", "near-singular", "inconsistent-1e-6"])
    """further sets, which are timed under the recommended settings only"""
    every: int = Field(1, ge=1, description="1: every problem, 2: every second one, ...")
    every_other: int = Field(4, ge=1)
    """for nlp-* and for settings that are not recommended. 1: all problems that `every` leaves, 2: every second of
    them, ..."""

    @field_validator("names", "timed", "timed_too")
    @classmethod
    def _exist(cls, value: Any) -> Any:
        for name in [] if value == "all" else value:
            testsets.check_name(name)
        return value

    def chosen(self) -> list[str]:
        """Return the names of the chosen sets."""
        return [name for name in testsets.NAMES if self.names == "all" or name in self.names]


class ClosedLoop(Settings):
    """Settings of the trials in closed loop."""

    KIND: ClassVar[str] = "[closed_loop]"
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1, description="the trials use them in turn")
    trials: int = Field(60, ge=1, description="trials of each cited solver, and of DCAC, which uses no solver")
    cited: list[str] = Field(["exact", "rnn", "rnn-printed"], description="solvers that the report's answer cites")
    others: int = Field(15, ge=1, description="number of trials of every other solver")
    timed: int = Field(1, ge=1, description="number of trials that run alone and are timed")
    duration_s: Level = Field(4.0, description="length of a trial; inf: the whole task")
    slow: list[str] = Field(["nlp-ipopt", "qpsolvers:highs", "qpsolvers:scs"])
    """solvers that are left out, because they take about a millisecond per tick"""

    def of(self, solver: str) -> int:
        """Return the number of trials of a solver or the baseline."""
        return self.trials if solver in (BASELINE, *self.cited) else min(self.others, self.trials)


class Config(StudyConfig):
    """Configuration of the study, as in moc_opt/study/solvers.toml."""

    solvers: Literal["all"] | list[str] = "all"
    twice: bool = Field(False, description="also run qpsolvers:NAME if NAME has its own adapter")
    parts: list[Literal["open_loop", "testsets", "closed_loop"]] = Field(["open_loop", "testsets", "closed_loop"])
    open_loop: OpenLoop = OpenLoop()
    testsets: TestSets = TestSets()
    closed_loop: ClosedLoop = ClosedLoop()
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict, description="changes of recommended settings")
    scenario: Scenario = Scenario()

    def quick(self) -> Self:
        """Return the configuration of a quicker study."""
        sets = ["circle", "infeasible", "jumps"]
        return self.change(
            open_loop={"ticks": 200, "cold": 10},
            testsets={"names": sets, "timed": [], "timed_too": sets, "every": 8, "every_other": 1, "rounds": 2,
                      "cold": 4, "seconds": 0.02, "setup_s": 6.0},
            closed_loop={"trials": 2, "others": 1, "duration_s": 1.0},
        )  # fmt: skip

    def cases(self) -> list[Scenario]:
        """Return the scenario of each trial in closed loop."""
        part = self.closed_loop
        base = self.scenario.change(duration_s=part.duration_s, start={"pose": "random"})
        return trials(base, part.tasks, seeds(self.seed, STREAM, part.trials))


@dataclass
class Work:
    """Data that all parts of the study use, and the results so far."""

    study: Study
    config: Config
    names: Sequence[str]  #: solvers that can run here
    summary: dict[str, dict[str, Any]] = field(default_factory=dict)  #: content of summary.json
    runs: Results = field(default_factory=Results)  #: one row per run in closed loop
    answers: Results = field(default_factory=Results)  #: one row per answer in open loop
    sections: list[Section] = field(default_factory=list)
    said: str = ""  #: what `say` printed last

    @cached_property
    def settings(self) -> list[SolverSetting]:
        """Every setting of every solver, the recommended ones first."""
        found = solver_settings(self.names, self.config.settings)
        return sorted(found, key=lambda setting: not setting.recommended)

    @property
    def recommended(self) -> list[SolverSetting]:
        """Each solver under its recommended setting."""
        return [setting for setting in self.settings if setting.recommended]

    @cached_property
    def sequence(self) -> Array:
        """The recorded subproblems (ticks, 11 n + 10)."""
        config = self.config
        base = config.scenario.change(start={"pose": "random"})
        (case,) = trials(base, [config.open_loop.task], seeds(config.seed, STREAM, 1))
        (found,) = self.study.run([Job(record, (case, config.open_loop.ticks))], "recording")
        if isinstance(found, Failed):
            raise StudyError(f"the sequence could not be recorded: {found}")
        return np.asarray(found)

    @property
    def timed(self) -> list[Mapping[str, Any]]:
        """The summary's entries with times."""
        return [row for part in TIMED for row in self.summary.get(part, {}).values()]

    def runner(self, what: str) -> Callable[..., list[Any]]:
        """Return `Study.run` with ``what`` as the text of its progress bar."""
        return partial(self.study.run, what=what)

    def say(self) -> None:
        """Print the first sentence of the report so far."""
        said = sentences(self.summary, assess(self.summary, self.runs))[0]
        if said != self.said:
            self.said = said
            console(stderr=True).print(f"so far: {said} (This may change.)", markup=False)


# --- the command ---

PARTS = {"open_loop": recorded_sequence, "testsets": certified_sets, "closed_loop": closed_loop}


def work(study: Study, config: Config) -> Found:
    """Run the study."""
    given = study.given
    if given.full and not given.quick:
        config = Config.load(FULL, config.seed)
    if given.parts:
        config = config.change(parts=given.parts)
    if given.sets:
        config = config.change(testsets={"names": given.sets, "timed_too": given.sets})
    names, missing = choose(given.only or config.solvers)
    if not (config.twice or given.only):
        names, again = once(names)
        missing |= again
    begins = f"solvers to compare: {len(names)} (`moc-opt solvers --list` only lists them)"
    console(stderr=True).print(begins, markup=False)
    found = Work(study, config, names, {"not_run": {name: {"reason": reason} for name, reason in missing.items()}})
    for name, part in PARTS.items():
        if name in config.parts:
            part(found)
            found.say()
    fresh = [NullSpaceQP.from_row(np.array(row)) for row in found.sequence]
    fresh[0].assembled()
    assembly = float(np.median(each_us(NullSpaceQP.assembled, fresh)))
    found.summary["clock"] = {"cost": {"p50_us": clock_cost_us()}, "assembly": {"p50_us": assembly}}
    slow = [name for name in names if name in config.closed_loop.slow and "closed_loop" in config.parts]
    told = [f"Too slow for the closed loop (about a millisecond per tick): {', '.join(slow)}. --full runs them."]
    return Found(
        report(found), found.summary, Results([*found.answers, *found.runs]),
        {"load": total(found.timed)}, sentences=told if slow else (),
    )  # fmt: skip


def once(names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Drop `qpsolvers:NAME` if NAME is listed, too. Return the other names, and a reason for each dropped one."""
    native = {f"{QPSOLVERS}{name}": name for name in names}
    return [name for name in names if name not in native], {
        name: f"the same library as `{native[name]}`: `twice = true` in the configuration runs both"
        for name in names if name in native
    }  # fmt: skip


def report(found: Work) -> Report:
    """Return the report on the study."""
    summary, scenario = found.summary, found.config.scenario
    rows = assess(summary, found.runs)
    troubles = [
        {"solver": name, "part": part, "trouble": words}
        for part, entries in summary.items() for name, row in entries.items() if isinstance(row, Mapping)
        if (words := row.get("reason") if part == "not_run" else row.get("trouble"))
    ]  # fmt: skip
    sections = found.sections
    if troubles:
        shown = [SOLVER, Column("part", "part"), Column("trouble", "first error, or why it did not run")]
        went_wrong = Table("What went wrong, and what did not run", shown, troubles)
        sections = [*sections, Section("Exceptions, hangs and crashes", "", [went_wrong])]
    title = f"Solvers of the null-space subproblem on the {scenario.robot.name}"
    about = f"{', '.join(found.config.closed_loop.tasks)}; gains {scenario.control.gains}"
    return Report(
        title, sentences(summary, rows), first_table(summary, rows), pictures(summary, rows, scenario.deadline_us),
        sections, load(found.timed), about,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None, *, program: str = "moc-opt solvers") -> int:
    """Run the command, and return the exit status."""
    for name in THREADS:  # the workers inherit these
        os.environ.setdefault(name, "1")

    def options(parser: ArgumentParser) -> None:
        parser.epilog = "`moc-opt solvers --list` prints the solvers that can run here, and their settings."
        parser.add_argument("--full", action="store_true", help=f"run the larger study of {FULL.name} in the package")
        parser.add_argument("--only", nargs="+", metavar="SOLVER", help="run only these solvers")
        parser.add_argument("--sets", nargs="+", metavar="NAME", help="use only these test sets")
        parser.add_argument("--parts", nargs="+", metavar="PART", choices=PARTS, help=f"run some of {', '.join(PARTS)}")

    return command(
        "solvers", "Compare the solvers in open loop and in closed loop.", Config, work, arguments,
        options=options, folder=Path(__file__).parent, program=program,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
