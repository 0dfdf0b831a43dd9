"""Which runs a sweep consists of: fixed by its configuration alone."""

from __future__ import annotations

import copy
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from benchmarks.sweeps.config import Config, chosen_seeds, chosen_solvers
from benchmarks.sweeps.fields import SweepError, grid_axes, random_draws, with_value
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.inputs.files import to_json
from moc_opt.scenario import Scenario, Setup
from moc_opt.scenario.tables import SolverTable
from moc_opt.study.trials import BASELINE, variant

MAX_RUNS = 100_000


@dataclass(frozen=True)
class Run:
    """One run of a sweep.

    Attributes:
        id: 20 hexadecimal digits, the same for the same scenario in whatever sweep it stands.
        solver: its name, or that of the baseline.
        seed: of the scenario.
        values: of the swept fields; None where one does not apply.
        scenario: the whole of it.
    """

    id: str
    solver: str
    seed: int
    values: Mapping[str, Any]
    scenario: Scenario


def plan(config: Config) -> list[Run]:
    """Return the runs in their order: grid, then sample, then seed, then solver; what is the same run stands once.

    Raises:
        UnknownNameError: a field, solver or setting that does not exist.
        SweepError: values that no scenario can be made of, or too many runs.
    """
    grid, seeds = grid_axes(config.grid), chosen_seeds(config)
    solvers, settings = chosen_solvers(config)
    samples = config.random.samples if config.random.fields else 1
    count = math.prod([*map(len, grid.values()), samples, len(seeds), len(solvers)])
    if count > MAX_RUNS:  # before anything is drawn or listed
        raise SweepError(
            f"{count} runs ([grid] x [random] samples x seeds x solvers): split what makes more than {MAX_RUNS} into "
            "several sweeps"
        )
    draws = random_draws(config.random.fields, samples, config.seed)
    if twice := grid.keys() & draws.keys():
        raise SweepError(f"{min(twice)} stands in [grid] and in [random.fields]: keep one")
    base, runs = config.scenario.model_dump(), dict[str, Run]()
    for *values, sample, seed, solver in product(*grid.values(), range(samples), seeds, solvers):
        fields = dict(zip(grid, values, strict=True)) | {path: drawn[sample] for path, drawn in draws.items()}
        if solver == BASELINE:  # which asks no solver
            fields = {path: None if path.startswith("solver.") else value for path, value in fields.items()}
        scenario = _scenario(base, solver, settings.get(solver, {}), seed, fields)
        try:
            text = to_json(scenario.model_dump(mode="json"), indent=None, sort_keys=True)
        except (TypeError, ValueError) as error:
            raise SweepError(f"{_words(solver, seed, fields)}: not a scenario: {error}") from error
        name = hashlib.sha256(text.encode()).hexdigest()[:20]
        runs.setdefault(name, Run(name, solver, seed, fields, scenario))
    _check_names(list(runs.values()))
    return list(runs.values())


def _scenario(
    base: Mapping[str, Any], solver: str, settings: Mapping[str, Any], seed: int, fields: Mapping[str, Any]
) -> Scenario:
    table = copy.deepcopy(dict(base)) | {"seed": seed}
    table["solver"] = (
        SolverTable().model_dump() if solver == BASELINE else {"name": solver, "settings": dict(settings)}
    )
    for path, value in fields.items():
        if value is not None:
            with_value(table, path, value)
    try:
        made = Scenario(**table)
    except MocOptError as error:
        if isinstance(unknown := error.__cause__ or error, UnknownNameError):
            raise unknown from None
        raise SweepError(f"{_words(solver, seed, fields)}: not a scenario: {error}") from error
    # A scenario that is DCAC already keeps the gains it asks for; others are compared with matched gains.
    return variant(made, BASELINE) if solver == BASELINE and made.control.law != "dcac" else made


def _check_names(runs: list[Run]) -> None:
    """Build what only a run would, once for every name: robots, paths, and solvers with their settings."""
    seen: set[tuple[str, Any]] = set()
    for run in runs:
        names = {("solver", run.solver)} | {(path, v) for path, v in run.values.items() if isinstance(v, str)}
        if names <= seen:
            continue
        seen |= names
        try:
            Setup(run.scenario).controller()
        except MocOptError as error:
            for cause in (error, error.__cause__):  # a scenario that is none says so in other words
                if isinstance(cause, UnknownNameError):
                    raise cause from None
            # else a combination that cannot run: its row will say so


def _words(solver: str, seed: int, fields: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value!r}" for name, value in {"solver": solver, "seed": seed, **fields}.items())
