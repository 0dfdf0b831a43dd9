"""How do the metrics of a run change with the fields of its scenario? Fields vary on a grid or at random.

python -m benchmarks.sweep [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--dask ADDRESS]

The same command continues a stopped sweep.
"""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from functools import partial
from itertools import chain, product
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.figures.notation import Mark
from moc_opt.inputs.files import to_json
from moc_opt.inputs.settings import Settings
from moc_opt.report.run_table import VERDICTS, is_nonlinear
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, Setup
from moc_opt.scenario.tables import MOST_S, SolverTable
from moc_opt.study.command import Found, Study, StudyConfig, command, runnable
from moc_opt.study.results import Results
from moc_opt.study.show import Picture, Report, Section, columns, lines_picture
from moc_opt.study.trials import BASELINE, Trial, variant

MOST_RUNS = 100_000
ELSEWHERE = {"seed": "seeds", "solver": "solvers", "solver.name": "solvers"}
SHOWN = (
    "mu_mean", "tip_error_mean_mm", "rcm_error_mean_mm", "trocar_force_mean_N", "torque_rate_rms_Nm_per_s",
    "silently_wrong",
)  # fmt: skip
TIMES = ("solve_p50_us", "solve_p99_us", "tick_p50_us", "tick_p99_us")
PLOTTED = {"mu_mean": "manipulability [m^3]", "rcm_error_mean_mm": "RCM error [mm]"}
EVERY = "Every table"


class SweepError(MocOptError, ValueError):
    """The configuration of a sweep cannot be used."""


class Draw(Settings):
    """A uniform distribution over a range, or equally likely values."""

    KIND: ClassVar[str] = "[random.fields]"
    ERROR: ClassVar[type[MocOptError]] = SweepError
    low: float = Field(0.0, ge=-1e15, le=1e15)
    high: float = Field(0.0, ge=-1e15, le=1e15)
    scale: Literal["linear", "log", "integer"] = Field("linear", description="integer: both ends included")
    choice: list[Any] | None = Field(None, min_length=1)

    @model_validator(mode="after")
    def _holds_values(self) -> Self:
        if self.choice is None and not self.low < self.high:
            raise ValueError(f"low = {self.low:g}, high = {self.high:g}: give low < high, or a choice")
        if self.choice is None and self.scale == "log" and self.low <= 0.0:
            raise ValueError(f"low = {self.low:g}: a logarithmic range begins above 0")
        if self.choice is None and self.scale == "integer" and math.floor(self.high) < math.ceil(self.low):
            raise ValueError(f"no whole number lies from {self.low:g} to {self.high:g}")
        return self

    def at(self, u: float) -> Any:
        """Return the quantile at u in [0, 1)."""
        if self.choice is not None:
            return self.choice[int(u * len(self.choice))]
        if self.scale == "integer":
            first = math.ceil(self.low)
            return first + int(u * (math.floor(self.high) - first + 1))
        if self.scale == "log":
            return min(max(self.low * (self.high / self.low) ** u, self.low), self.high)
        return self.low + u * (self.high - self.low)


class RandomSample(Settings):
    KIND: ClassVar[str] = "[random]"
    samples: int = Field(1, ge=1, le=MOST_RUNS)
    fields: dict[str, Any] = Field(default_factory=dict, description="a range or a choice, by dotted path of the field")


class Config(StudyConfig):
    seeds: int | list[int] = Field(1, description="number of seeds, or a list of seeds")
    solvers: list[str] | None = Field(None, description="names, or 'dcac'; by default, the scenario's solver")
    timed: bool = Field(False, description="make one run at a time and keep its times")
    run_limit_s: float = Field(600.0, gt=0.0, le=MOST_S, description="a run that takes longer is stopped")
    grid: dict[str, Any] = Field(default_factory=dict, description="a list of values, by dotted path of the field")
    random: RandomSample = RandomSample()
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict, description="settings of each solver")
    scenario: Scenario = Scenario()

    def quick(self) -> Self:
        solvers = None if self.solvers is None else self.solvers[:2]
        left_out = {*(self.solvers or ())} - {*(solvers or ())}
        return self.model_copy(update={
            "seeds": list(self.chosen_seeds()[:1]), "solvers": solvers,
            "grid": {path: values[:2] for path, values in grid_axes(self.grid).items()},
            "random": self.random.model_copy(update={"samples": min(self.random.samples, 2)}),
            "settings": {n: s for n, s in self.settings.items() if n not in left_out},
            "scenario": self.scenario.change(duration_s=min(self.scenario.duration_s or 0.2, 0.2)),
        })  # fmt: skip

    def chosen_seeds(self) -> Sequence[int]:
        return self.seeds if isinstance(self.seeds, list) else range(self.seed, self.seed + self.seeds)

    def chosen_solvers(self) -> dict[str, dict[str, Any]]:
        """Return each solver's settings. Raise a SolverError if one cannot run."""
        table = self.scenario.solver
        if self.solvers is None:
            found = {table.name: table.settings}
        elif table == SolverTable():
            found = {name: {} for name in runnable(self.solvers, BASELINE)}
        else:
            raise SweepError("solvers and [scenario.solver] are both given: give only solvers and [settings]")
        for name in self.settings:
            if name not in found:
                raise UnknownNameError("solver in [settings]", name, found)
        found = {name: {**own, **self.settings.get(name, {})} for name, own in found.items()}
        if self.solvers is None and self.scenario.control.law == "dcac":
            return {BASELINE: found[table.name]}
        return found


# --- the fields that vary: fields of a scenario, by dotted path ---


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted path, value). A table that has a key low, high or choice counts as a value."""
    for name, value in table.items():
        path, nested = f"{prefix}{name}", isinstance(value, Mapping) and not {"low", "high", "choice"} & value.keys()
        if path in ELSEWHERE and not (path == "solver" and nested):
            raise SweepError(f"{path!r} cannot be swept as a field: give {ELSEWHERE[path]!r} in the configuration")
        if nested:
            yield from flat(value, f"{path}.")
        else:
            yield path, value


def grid_axes(table: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the values for each dotted path."""
    found = dict(flat(table))
    for path, values in found.items():
        if not isinstance(values, list) or not values:
            raise SweepError(f"[grid] {path} = {values!r}: give a list of values")
    return found


def random_draws(table: Mapping[str, Any], samples: int, seed: int) -> dict[str, list[Any]]:
    """Return ``samples`` values for each dotted path.

    Each field has its own random stream, so adding fields or samples leaves the other values as they are.
    """
    draws: dict[str, list[Any]] = {}
    for path, entry in flat(table):
        if not isinstance(entry, Mapping):
            raise SweepError(f"[random.fields] {path} = {entry!r}: give {{low = .., high = ..}} or {{choice = [..]}}")
        words = np.frombuffer(hashlib.sha256(path.encode()).digest(), dtype=np.uint32)
        uniform = np.random.default_rng([seed, *words.tolist()]).random(samples)
        draws[path] = [Draw(**entry).at(u) for u in uniform.tolist()]
    return draws


# --- the runs ---


def plan(config: Config) -> list[Trial]:
    """Return the runs. Equal runs are listed once."""
    grid, seeds, solvers = grid_axes(config.grid), config.chosen_seeds(), config.chosen_solvers()
    samples = config.random.samples if config.random.fields else 1
    count = math.prod([*map(len, grid.values()), samples, len(seeds), len(solvers)])
    if not count:
        raise SweepError("0 runs: give at least one solver and one seed (seeds = 1)")
    if count > MOST_RUNS:
        raise SweepError(f"{count} runs: a sweep has 1 to {MOST_RUNS}; split a larger one into several")
    draws = random_draws(config.random.fields, samples, config.seed)
    if twice := grid.keys() & draws.keys():
        raise SweepError(f"{min(twice)} is in [grid] and in [random.fields]: keep one")
    found: dict[str, Trial] = {}
    for *values, sample, seed, solver in product(*grid.values(), range(samples), seeds, solvers):
        fields = dict(zip(grid, values, strict=True)) | {path: drawn[sample] for path, drawn in draws.items()}
        if solver == BASELINE:  # DCAC has no solver
            fields = {path: value for path, value in fields.items() if not path.startswith("solver.")}
        case = _case(config.scenario, seed, fields)
        if solver != BASELINE and case.control.law == "dcac":
            raise SweepError(f"law = 'dcac' has no solver {solver!r}: give law = 'moc', and 'dcac' in solvers")
        settings = {**solvers[solver], **case.solver.settings}
        try:
            key = to_json([solver, settings, case.model_dump(mode="json")], indent=None, sort_keys=True)
        except (TypeError, ValueError) as error:
            raise SweepError(f"seed = {seed}, {_words(fields)}: not a scenario: {error}") from error
        tags = {p: to_json(v, indent=None) if isinstance(v, list | dict) else v for p, v in fields.items()}
        found.setdefault(key, Trial(case.change(name=f"run {len(found)}"), solver, settings, tags, config.timed))
    _check_names(list(found.values()))
    return list(found.values())


def _case(base: Scenario, seed: int, fields: Mapping[str, Any]) -> Scenario:
    changes: dict[str, Any] = {"seed": seed}
    for path, value in fields.items():
        *outer, last = path.split(".")
        table = changes
        for name in outer:
            table = table.setdefault(name, {})
        table[last] = deepcopy(value)  # another path may set a field of this table
    try:
        return base.change(**changes)
    except MocOptError as error:
        raise SweepError(f"seed = {seed}, {_words(fields)}: not a scenario: {error}") from error


def _words(fields: Mapping[str, Any]) -> str:
    return ", ".join(f"{path} = {value!r}" for path, value in fields.items())


def _check_names(runs: Sequence[Trial]) -> None:
    """Raise on wrong names before any run."""
    seen: set[tuple[str, Any]] = set()
    for run in runs:
        names = {("solver", run.controller)} | {(path, v) for path, v in run.tags.items() if isinstance(v, str)}
        if names <= seen:
            continue
        seen |= names
        try:
            Setup(variant(run.case, run.controller, run.settings)).controller()
        except UnknownNameError:
            raise
        except MocOptError as error:
            if isinstance(error.__cause__, UnknownNameError):
                raise
            # After any other error the sweep goes on: the run's row reports it.


# --- the figures ---


def work(study: Study, config: Config) -> Found:
    asked = plan(config)
    rows = Results(run.row for run in study.trials(asked, limit_s=config.run_limit_s))
    grid = {path: values for path, values in grid_axes(config.grid).items() if len(values) > 1}
    summary: dict[str, Any] = {"all": grouped(rows)} | {f"by {path}": grouped(rows, path) for path in grid}
    lost = any(str(row["error"]).startswith(("hung", "crashed")) for row in rows.failed())
    return Found(report(summary, rows, grid, config), summary, rows, status=1 if lost else 0)


def grouped(rows: Results, field: str = "") -> dict[str, dict[str, Any]]:
    """Count the runs of each solver and value of ``field``. Add means and percentiles over completed runs."""
    found = {}
    for controller in rows.names():
        for value in rows.names(field) if field else [None]:
            mine = rows.where(controller=controller)
            mine = mine.where(**{field: value}) if field else mine
            if not len(mine):
                continue
            group: dict[str, Any] = {"runs": len(mine), "failed": len(mine.failed())}
            group["oscillated"] = sum(str(row["ended"]).startswith("oscillated") for row in mine)
            group["remarks"] = mine.failures(controller)
            unjudged = VERDICTS if is_nonlinear(controller) else ()
            for metric in (name for name in (*SHOWN, *TIMES) if name not in unjudged):
                values = [row[metric] for row in mine if row.get("whole") and row.get(metric) is not None]
                if values:
                    low, high = np.percentile(values, (5, 95)).tolist()
                    group |= {metric: float(np.mean(values)), f"{metric}_p05": low, f"{metric}_p95": high}
            found[controller if value is None else f"{controller}, {value}"] = group
    return found


def report(summary: Mapping[str, Any], rows: Results, axes: Mapping[str, list[Any]], config: Config) -> Report:
    metrics = [*SHOWN, *(TIMES if config.timed else ())]
    remarks = [*chain.from_iterable(row["remarks"] for row in summary["all"].values())]
    said = " ".join([*(["!:"] if remarks else []), *remarks, "Means are over completed runs."])

    def table(title: str, part: str, metrics: Sequence[str] = metrics) -> Table:
        shown = [
            {"group": Mark("!", name, "bad") if row["remarks"] else name, **row} for name, row in summary[part].items()
        ]
        link = EVERY if part == "all" else ""
        heads = columns("runs", "failed", *metrics, of=link, torque_rate_rms_Nm_per_s="chatter")
        return Table(title, [Column("group", "solver" if part == "all" else "solver, value"), *heads], shown, said)

    mu = {name: row["mu_mean"] for name, row in summary["all"].items() if "mu_mean" in row and not row["remarks"]}
    answer = [f"{len(rows.failed())} of {len(rows)} runs did not complete their task."]
    if len(mu) > 1:
        best, worst = max(mu, key=mu.__getitem__), min(mu, key=mu.__getitem__)
        answer.append(f"Mean manipulability is between {mu[worst]:.4f} ({worst}) and {mu[best]:.4f} ({best}) m^3.")
    tables = [table(f"By solver and {path}", f"by {path}") for path in axes]
    sections = [Section(EVERY, "", [table("By solver", "all"), *tables])]
    title = f"Sweep over {', '.join([*axes, *config.random.fields]) or 'seeds'}"
    first = table("Every solver", "all", ("mu_mean", "tip_error_mean_mm", "rcm_error_mean_mm", "silently_wrong"))
    return Report(title, answer, first, pictures(summary, axes)[:3], sections)


def pictures(summary: Mapping[str, Any], axes: Mapping[str, list[Any]]) -> list[Picture]:
    found = []
    for field, values in axes.items():
        if not all(type(value) in (int, float) for value in values):
            continue
        wide, by = min(values) > 0.0 and max(values) >= 30.0 * min(values), summary[f"by {field}"]
        for metric, words in PLOTTED.items():
            lines = {
                solver: [
                    (value, row[f"{metric}_p05"], row[metric], row[f"{metric}_p95"])
                    for value in sorted(values) if metric in (row := by.get(f"{solver}, {value}", {}))
                ] for solver in summary["all"]
            }  # fmt: skip
            says = f"{words} over {field}: means, with bars from the 5th to the 95th percentile."
            found.append(Picture(lines_picture(lines, field, words, log=wide), says, f"{metric}-{field}"))
    return found


main = partial(command, "sweep", "Vary any field of a scenario, over solvers and seeds.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
