"""Which runs a sweep consists of: fixed by its configuration alone, each with an id made of its whole scenario."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.sweeps.config import Config, chosen_seeds, chosen_solvers
from benchmarks.sweeps.errors import SweepError
from benchmarks.sweeps.fields import grid_axes, random_draws, with_value
from benchmarks.sweeps.version import code_version
from moc_opt.comparison.trials import BASELINE, variant
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.scenario import Scenario, Setup
from moc_opt.scenario.tables import SolverTable
from moc_opt.trace.metrics import METRICS

FORMAT = 1
"""Of what a sweep's folder holds; part of every id."""
MAX_RUNS = 10_000_000


@dataclass(frozen=True)
class Point:
    """One run: the solver (or the baseline), the seed, and the swept fields; None where one does not apply."""

    solver: str
    seed: int
    values: Mapping[str, Any]


class Plan:
    """The runs of a sweep, in their order: grid, then sample, then seed, then solver (the fastest to change).

    Raises:
        UnknownNameError: a field, solver or setting that does not exist.
        SweepError: values that no scenario can be made of.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.grid = grid_axes(config.grid)
        self.seeds = chosen_seeds(config)
        self.solvers, self._settings = chosen_solvers(config)
        sizes = (*map(len, self.grid.values()), config.random.samples, len(self.seeds), len(self.solvers))
        if math.prod(sizes) > MAX_RUNS:  # before anything is drawn or listed
            raise SweepError(
                f"{math.prod(sizes)} runs ([grid] x [random] samples x seeds x solvers); split what makes more than "
                f"{MAX_RUNS} into several sweeps"
            )
        self.draws = random_draws(config.random.fields, config.random.samples, config.seed)
        twice = self.grid.keys() & self.draws.keys()
        if twice:
            raise SweepError(f"{min(twice)} stands in [grid] and in [random.fields]: keep one")
        self.fields = [*self.grid, *self.draws]
        samples = config.random.samples if self.draws else 1
        self._shape = (*map(len, self.grid.values()), samples, len(self.seeds), len(self.solvers))
        self.combinations = math.prod(self._shape)
        self._base = config.scenario.model_dump()
        self._numbers: NDArray[np.int64] | None = None  # run -> combination
        self._ids: NDArray[np.bytes_] = np.empty(0, dtype="S20")

    def number_runs(self, advance: Callable[[int], None] = lambda done: None) -> Plan:
        """Build every scenario once, before anything runs; combinations that are the same run become one.

        Args:
            advance: called now and then with the combinations done since.

        Raises:
            SweepError: values that no scenario takes.
        """
        seen: dict[bytes, int] = {}
        for number in range(self.combinations):
            seen.setdefault(self._identity(self._point(number)), number)
            if number % 1000 == 999:
                advance(1000)
        advance(self.combinations % 1000)
        self._numbers = np.fromiter(seen.values(), dtype=np.int64, count=len(seen))
        self._ids = np.array(list(seen), dtype="S20")
        return self

    def __len__(self) -> int:
        """Return the number of different runs."""
        if self._numbers is None:
            self.number_runs()
        return len(self._ids)

    def point(self, index: int) -> Point:
        """Return what distinguishes run ``index``."""
        run = range(len(self))[index]
        return self._point(run if self._numbers is None else int(self._numbers[run]))

    def run_id(self, index: int) -> str:
        """Return 20 hexadecimal digits, the same for the same scenario in whatever sweep it stands."""
        run = range(len(self))[index]
        return bytes(self._ids[run]).decode()

    def scenario(self, index: int) -> Scenario:
        """Return the whole scenario of run ``index``."""
        return self._scenario(self.point(index))

    @cached_property
    def metrics(self) -> list[str]:
        """Return the names of the metrics of every run."""
        return list(METRICS)

    @cached_property
    def description(self) -> dict[str, Any]:
        """Return all that decides what the rows will hold, as JSON gives it back: folders with the same go together."""
        config = self.config.model_dump(mode="json", exclude={"run_limit_s"})
        config |= {"solvers": self.solvers, "seeds": self.seeds, "grid": self.grid}
        whole = {"format": FORMAT, "moc_opt": code_version(), "metrics": self.metrics, "config": config}
        found: dict[str, Any] = json.loads(canonical(whole))
        return found

    @cached_property
    def digest(self) -> str:
        """Of the description."""
        return digest_of(self.description)

    def check_names(self) -> None:
        """Build what only a run would: robots, paths and solvers with their settings, once for every name.

        Raises:
            UnknownNameError: a name in a value, or a setting that a solver does not have.
        """
        first = self._point(0).values
        names = [(p, v) for p, vs in (self.grid | self.draws).items() for v in vs if isinstance(v, str)]
        cases = [Point(solver, self.seeds[0], first) for solver in self.solvers]
        cases += [Point(self.solvers[0], self.seeds[0], {p: v}) for p, v in dict.fromkeys(names)]
        for case in cases:
            try:
                Setup(self._scenario(case)).controller()
            except MocOptError as error:
                for cause in (error, error.__cause__):  # a scenario that is none says so in other words
                    if isinstance(cause, UnknownNameError):
                        raise cause from None
                # else a combination that cannot run: its row will say so

    def _point(self, number: int) -> Point:
        *grid, sample, seed, solver = (int(i) for i in np.unravel_index(number, self._shape))
        values = {path: axis[i] for (path, axis), i in zip(self.grid.items(), grid, strict=True)}
        values |= {path: drawn[sample] for path, drawn in self.draws.items()}
        name = self.solvers[solver]
        if name == BASELINE:  # which asks no solver
            values = {path: None if path.startswith("solver.") else value for path, value in values.items()}
        return Point(name, self.seeds[seed], values)

    def _scenario(self, point: Point) -> Scenario:
        table = copy.deepcopy(self._base)
        table["seed"] = point.seed
        table["solver"] = {"name": point.solver, "settings": dict(self._settings.get(point.solver, {}))}
        if point.solver == BASELINE:
            table["solver"] = SolverTable().model_dump()
        for path, value in point.values.items():
            if value is not None:
                with_value(table, path, value)
        try:
            made = Scenario(**table)
        except MocOptError as error:
            raise SweepError(f"{_words(point)}: not a scenario: {error}") from error
        # A scenario that is DCAC already keeps the gains it asks for; others are compared with matched gains.
        return variant(made, BASELINE) if point.solver == BASELINE and made.control.law != "dcac" else made

    def _identity(self, point: Point) -> bytes:
        table = self._scenario(point).model_dump(mode="json")
        try:
            text = canonical({"format": FORMAT, "scenario": table})
        except (TypeError, ValueError) as error:
            raise SweepError(f"{_words(point)}: not a scenario: {error}") from error
        return hashlib.sha256(text.encode()).hexdigest()[:20].encode()


def canonical(value: Any) -> str:
    """Return one text for one value; NaN and infinity are refused."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest_of(description: Any) -> str:
    """Hash a plan's description; ValueError or TypeError where that is none."""
    return hashlib.sha256(canonical(description).encode()).hexdigest()


def differences(here: Any, there: Any, path: str = "") -> Iterator[str]:
    """Return where two descriptions differ, in words."""
    if isinstance(here, dict) and isinstance(there, dict):
        for name in sorted(here.keys() | there.keys()):
            yield from differences(here.get(name), there.get(name), f"{path}.{name}" if path else name)
    elif here != there:
        yield f"{path.removeprefix('config.')} is {here!r:.100} here and {there!r:.100} there"


def _words(point: Point) -> str:
    values = {"solver": point.solver, "seed": point.seed, **point.values}
    return ", ".join(f"{name} = {value!r}" for name, value in values.items())
