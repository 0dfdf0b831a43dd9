"""The TOML of a sweep: its fields, solvers and seeds."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

from pydantic import Field

from benchmarks.common.config import Configuration, runnable
from benchmarks.sweeps.fields import SweepError, grid_axes
from moc_opt.errors import UnknownNameError, shown
from moc_opt.inputs.files import LARGEST_INTEGER
from moc_opt.inputs.settings import Settings
from moc_opt.scenario import Scenario
from moc_opt.scenario.tables import MOST_S, SolverTable
from moc_opt.study.trials import BASELINE

MOST_LISTED = 1_000_000
"""Seeds, and random samples, of one sweep."""


class RandomSample(Settings):
    """Fields that are drawn, together, ``samples`` times."""

    KIND: ClassVar[str] = "[random]"
    samples: int = Field(1, ge=1, le=MOST_LISTED)
    fields: dict[str, Any] = Field(default_factory=dict, description="path -> range or choice")


class Config(Configuration):
    """benchmarks/configs/sweep.toml."""

    seed: int = Field(
        0, ge=0, le=LARGEST_INTEGER - MOST_LISTED,
        description="of the random sample, and the first of the scenarios' seeds",
    )  # fmt: skip
    seeds: int | list[int] = Field(1, description="how many, or which")
    solvers: Literal["all"] | list[str] | None = Field(None, description="None: the scenario's; dcac: no solver")
    run_limit_s: float = Field(
        600.0, gt=0.0, le=MOST_S, description="a run that takes longer is stopped with its process"
    )
    grid: dict[str, Any] = Field(default_factory=dict, description="path -> list of values")
    random: RandomSample = RandomSample()
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict, description="per solver")
    scenario: Scenario = Scenario()

    def quick(self) -> Self:
        """Return the same sweep with the first two values of everything, and short runs."""
        solvers = None if self.solvers is None else chosen_solvers(self)[0][:2]
        length = min(self.scenario.duration_s or 0.2, 0.2)
        return self.model_copy(
            update={
                "seeds": chosen_seeds(self)[:1], "solvers": solvers,
                "grid": {path: values[:2] for path, values in grid_axes(self.grid).items()},
                "random": self.random.model_copy(update={"samples": min(self.random.samples, 2)}),
                "settings": {n: s for n, s in self.settings.items() if solvers is None or n in solvers},
                "scenario": self.scenario.change(duration_s=length),
            }
        )  # fmt: skip


def chosen_seeds(config: Config) -> list[int]:
    """Return the seeds of the scenarios.

    Raises:
        SweepError: there is none, or one twice.
    """
    wanted = config.seeds
    if isinstance(wanted, int) and not 1 <= wanted <= MOST_LISTED:
        raise SweepError(f"seeds = {wanted}: give how many (1 or more, {MOST_LISTED} at most), or a list of them")
    seeds = wanted if isinstance(wanted, list) else [config.seed + i for i in range(wanted)]
    if not seeds or len(set(seeds)) < len(seeds) or min(seeds) < 0:
        raise SweepError(f"seeds = {shown(wanted)}: give how many (1 or more), or a list of different ones, 0 or more")
    return seeds


def chosen_solvers(config: Config) -> tuple[list[str], dict[str, dict[str, Any]]]:
    """Return the names in order, and name -> settings; every one of them can run here.

    Raises:
        UnknownNameError: no such solver.
        SolverError: a solver that is asked for by name cannot run here.
        SweepError: none, one twice, or settings in two places.
    """
    table = config.scenario.solver
    if config.solvers is None:
        baseline = config.scenario.control.law == "dcac"
        return [BASELINE if baseline else table.name], {
            table.name: {**table.settings, **config.settings.get(table.name, {})}
        }
    if table != SolverTable():
        raise SweepError("solvers and [scenario.solver] are both given: name them in solvers, set them in [settings]")
    names = runnable(config.solvers, BASELINE)
    if not names or len(set(names)) < len(names):
        raise SweepError(f"solvers = {names}: give one or more, each once")
    for name in config.settings:
        if name not in names:
            raise UnknownNameError("solver in [settings]", name, names)
    return names, config.settings
