"""benchmarks/configs/solvers.toml: the solvers, their problems, and the time limits."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, field_validator

from benchmarks.common.config import Configuration
from benchmarks.solver_study.answers import Limits
from benchmarks.subproblems.recipes import RECIPES
from moc_opt.errors import UnknownNameError
from moc_opt.inputs.settings import Level, Settings
from moc_opt.scenario import Scenario
from moc_opt.study.trials import BASELINE

Parts = Literal["open_loop", "testsets", "growth", "closed_loop", "sweeps", "duals", "qpbenchmark"]
PARTS: tuple[Parts, ...] = (
    "open_loop", "testsets", "growth", "closed_loop", "sweeps", "duals", "qpbenchmark",
)  # fmt: skip
USUAL: tuple[Parts, ...] = PARTS[:-1]  # qpbenchmark's ranking of the same libraries decides no verdict

SLOW = ("nlp-ipopt", "nlp-fatrop", "qpsolvers:highs", "qpsolvers:scs")
TASKS = ("circle", "sinusoid", "spiral")  # the paper's


class OpenLoop(Settings):
    """The recorded sequence."""

    KIND: ClassVar[str] = "[open_loop]"
    task: str = "circle"
    ticks: int = Field(500, ge=2)
    cold: int = Field(50, ge=1)


class ClosedLoop(Settings):
    """The trials."""

    KIND: ClassVar[str] = "[closed_loop]"
    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1, description="of the trials, in turn")
    trials: int = Field(60, ge=1, description="of DCAC and the cited solvers, each with a seed of its own")
    cited: list[str] = Field(["exact", "rnn", "rnn-printed"], description="solvers that the first sentences speak of")
    others: int = Field(15, ge=1, description="trials of every other solver, the first ones")
    timed: int = Field(1, ge=1, description="trials that run alone, the only ones whose times are used")
    duration_s: Level = Field(4.0, description="of a trial; inf: the whole task")
    short: list[str] = Field(list(SLOW), description="solvers whose runs are short: they take a millisecond a tick")
    short_s: float = Field(1.0, gt=0.0, description="of each of their trials; compared with the same ticks of others")

    def of(self, solver: str) -> int:
        """Return the number of trials that a solver, or the baseline, runs: the first so many."""
        return self.trials if solver in (BASELINE, *self.cited) else min(self.others, self.trials)


class TestSets(Settings):
    """The certified sets."""

    __test__: ClassVar[bool] = False  # not a class of tests

    KIND: ClassVar[str] = "[testsets]"
    names: Literal["all"] | list[str] = "all"
    timed: list[str] = Field(["circle", "circle-rho0", "random"], description="under every setting")
    timed_too: list[str] = Field(
        ["infeasible", "joint-limits", "jumps", "near-singular", "inconsistent-1e-6"],
        description="under the recommended settings",
    )
    every: int = Field(1, ge=1, description="take each every-th problem")
    every_other: int = Field(4, ge=1, description="under default and tight settings, and of nlp-*, each so many-th")
    rounds: int = Field(8, ge=1)
    seconds: float = Field(0.05, gt=0.0, description="of timing a set, at most")
    patience_s: float = Field(1.0, gt=0.0, description="longer without an answer is a hang")
    setup_s: float = Field(15.0, gt=0.0, description="longer without being set up is one too")
    cold: int = Field(16, ge=1)

    @field_validator("names", "timed", "timed_too")
    @classmethod
    def _exist(cls, value: Any) -> Any:
        for name in [] if value == "all" else value:
            if name not in RECIPES:
                raise UnknownNameError("test set", name, RECIPES)
        return value

    def chosen(self) -> list[str]:
        """Return the names of the sets, in the order of their recipes."""
        return [name for name in RECIPES if self.names == "all" or name in self.names]

    def times(self, recommended: bool) -> list[str]:
        """Return the names of the sets that are timed."""
        return [*self.timed, *self.timed_too] if recommended else self.timed

    def limits(self) -> Limits:
        """Return the limits of time and number of solves."""
        return Limits(self.patience_s, self.rounds, self.seconds, self.cold, self.setup_s)


class Growth(Settings):
    """Arms with more joints."""

    KIND: ClassVar[str] = "[growth]"
    joints: list[int] = Field([7, 10, 14], min_length=2)
    nonlinear: bool = Field(False, description="nlp-*, whose programs take minutes to build for many joints")


class Sweeps(Settings):
    """What is varied in closed loop."""

    KIND: ClassVar[str] = "[sweeps]"
    trials: int = Field(9, ge=1, description="the first ones of [closed_loop]")
    duration_s: Level = Field(4.0, description="of a trial; as in [closed_loop], its runs count in the prediction too")
    values: Literal["few", "usual", "many"] = "usual"
    deadline_solvers: list[str] = Field(["osqp", "piqp"])
    late_percent: list[float] = Field([1.0, 20.0], description="of the recorded times, above the budget")


class Config(Configuration):
    """The whole file."""

    KIND: ClassVar[str] = "configuration:"
    seed: int = Field(0, ge=0)
    solvers: Literal["all"] | list[str] = "all"
    twice: bool = Field(False, description="qpsolvers:NAME too where NAME has an adapter of its own")
    parts: list[Parts] = Field(list(USUAL))
    processes: int = Field(2, ge=1, description="at a time, where no times are measured")
    open_loop: OpenLoop = OpenLoop()
    testsets: TestSets = TestSets()
    growth: Growth = Growth()
    closed_loop: ClosedLoop = ClosedLoop()
    sweeps: Sweeps = Sweeps()
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict, description="per solver")
    scenario: Scenario = Scenario()

    def quick(self) -> Self:
        """Return the same study on less data: for a first look and for the tests."""
        few = {
            "names": ["circle", "infeasible", "jumps"], "timed": [], "timed_too": ["circle", "infeasible", "jumps"],
            "every": 8, "every_other": 1, "rounds": 2, "cold": 4, "seconds": 0.02, "setup_s": 6.0,
        }  # fmt: skip
        return self._with(
            open_loop={"ticks": 200, "cold": 10},
            testsets=few,
            growth={"joints": [7, 10]},
            closed_loop={"trials": 2, "others": 1, "duration_s": 1.0},
            sweeps={
                "trials": 1, "duration_s": 0.7, "values": "few", "deadline_solvers": ["osqp"], "late_percent": [5.0],
            },
            parts=[part for part in self.parts if part != "growth"],
        )  # fmt: skip

    def full(self) -> Self:
        """Return the study with more of everything, for figures to be cited: an hour or two."""
        return self._with(
            twice=True,
            parts=list(PARTS),
            open_loop={"ticks": 4000, "cold": 400},
            testsets={
                "timed": list(RECIPES), "timed_too": [], "every_other": 1, "rounds": 100, "seconds": 10.0, "cold": 128,
                "patience_s": 10.0,
            },
            growth={"joints": list(range(7, 15)), "nonlinear": True},
            closed_loop={
                "tasks": list(TASKS), "trials": 120, "others": 30, "timed": 3, "duration_s": None, "short": [],
            },
            sweeps={
                "trials": 15, "duration_s": None, "values": "many",
                "deadline_solvers": ["osqp", "piqp", "clarabel"], "late_percent": [0.1, 1.0, 5.0, 20.0],
            },
        )  # fmt: skip

    def choosing(self, sets: list[str] | None, parts: list[Parts] | None) -> Config:
        """Return the same on some sets and with some parts alone; None leaves them as they are.

        Raises:
            UnknownNameError: no such set.
        """
        changes: dict[str, Any] = {} if parts is None else {"parts": parts}
        if sets is not None:
            changes["testsets"] = TestSets(**{**self.testsets.model_dump(), "names": sets, "timed_too": sets})
        return self._with(**{k: v.model_dump() if isinstance(v, TestSets) else v for k, v in changes.items()})

    def _with(self, **changes: Any) -> Self:
        update = {
            name: getattr(self, name).model_copy(update=value) if isinstance(value, dict) else value
            for name, value in changes.items()
        }
        return self.model_copy(update=update)
