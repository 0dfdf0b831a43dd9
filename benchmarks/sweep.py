"""How do the figures change with any field of a scenario? A grid and random samples over fields, x solvers x seeds.

python -m benchmarks.sweep [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--dask ADDRESS]

The runs follow from the configuration alone, and every path, name and scenario is checked before anything runs. It can
be stopped at any moment, and the same command goes on. docs/scaling.md describes the configuration.
"""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, ClassVar, Literal, Self, get_args, get_origin

import numpy as np
from pydantic import BaseModel, Field

from moc_opt.errors import MocOptError, UnknownNameError, shown
from moc_opt.figures.style import Styles, figure
from moc_opt.inputs.files import LARGEST_INTEGER, to_json
from moc_opt.inputs.settings import Settings
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, Setup
from moc_opt.scenario.tables import MOST_S, SolverTable
from moc_opt.study.command import Found, Study, StudyConfig, command, runnable
from moc_opt.study.results import Results
from moc_opt.study.show import Picture, Report, Section, columns
from moc_opt.study.trials import BASELINE, Trial, variant

MOST_RUNS, MOST_LISTED = 100_000, 1_000_000
ELSEWHERE = {"seed": "seeds", "solver.name": "solvers"}
SHOWN = (
    "mu_mean", "tip_error_mean_mm", "rcm_error_mean_mm", "trocar_force_mean_N", "torque_rate_rms_Nm_per_s",
    "silently_wrong",
)  # fmt: skip
TIMES = ("solve_p50_us", "solve_p99_us", "tick_p50_us", "tick_p99_us")
PLOTTED = {"mu_mean": "manipulability [m^3]", "rcm_error_mean_mm": "RCM error [mm]"}
EVERY = "Every table"


class SweepError(MocOptError, ValueError):
    """The configuration of a sweep cannot be used."""


class Range(Settings):
    """A range to draw from, uniformly on its scale; ``integer`` draws whole numbers, both ends included."""

    KIND: ClassVar[str] = "range:"
    ERROR: ClassVar[type[MocOptError]] = SweepError
    low: float = Field(ge=-1e15, le=1e15)
    high: float = Field(ge=-1e15, le=1e15)
    scale: Literal["linear", "log", "integer"] = "linear"


class Choice(Settings):
    """Values to draw from, each as likely as the others."""

    KIND: ClassVar[str] = "choice:"
    ERROR: ClassVar[type[MocOptError]] = SweepError
    choice: list[Any] = Field(min_length=1)


class RandomSample(Settings):
    """Fields that are drawn, together, ``samples`` times."""

    KIND: ClassVar[str] = "[random]"
    samples: int = Field(1, ge=1, le=MOST_LISTED)
    fields: dict[str, Any] = Field(default_factory=dict, description="path -> range or choice")


class Config(StudyConfig):
    """benchmarks/configs/sweep.toml."""

    seed: int = Field(0, ge=0, le=LARGEST_INTEGER - MOST_LISTED, description="of the sample; first of the runs' seeds")
    seeds: int | list[int] = Field(1, description="how many, or which")
    solvers: list[str] | None = Field(None, description="None: the scenario's; dcac: no solver")
    timed: bool = Field(False, description="one run at a time, so that times count")
    run_limit_s: float = Field(600.0, gt=0.0, le=MOST_S, description="a run that takes longer is ended")
    grid: dict[str, Any] = Field(default_factory=dict, description="path -> list of values")
    random: RandomSample = RandomSample()
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict, description="per solver")
    scenario: Scenario = Scenario()

    def quick(self) -> Self:
        """Return the same sweep with the first two values of everything, and short runs."""
        solvers = None if self.solvers is None else self.solvers[:2]
        return self.model_copy(update={
            "seeds": self.chosen_seeds()[:1], "solvers": solvers,
            "grid": {path: values[:2] for path, values in grid_axes(self.grid).items()},
            "random": self.random.model_copy(update={"samples": min(self.random.samples, 2)}),
            "settings": {n: s for n, s in self.settings.items() if solvers is None or n in solvers},
            "scenario": self.scenario.change(duration_s=min(self.scenario.duration_s or 0.2, 0.2)),
        })  # fmt: skip

    def chosen_seeds(self) -> list[int]:
        """Return the seeds of the scenarios.

        Raises:
            SweepError: there is none, or one twice.
        """
        wanted = self.seeds
        seeds = wanted if isinstance(wanted, list) else [self.seed + i for i in range(min(wanted, MOST_LISTED))]
        if not seeds or len(set(seeds)) < len(seeds) or min(seeds) < 0:
            raise SweepError(f"seeds = {shown(wanted)}: give how many (1 or more), or a list of different ones")
        return seeds

    def chosen_solvers(self) -> dict[str, dict[str, Any]]:
        """Return name -> settings, in order; every one of them can run here.

        Raises:
            UnknownNameError: no such solver.
            SolverError: one cannot run here.
            SweepError: none, one twice, or settings in two places.
        """
        table = self.scenario.solver
        if self.solvers is None:
            name = BASELINE if self.scenario.control.law == "dcac" else table.name
            return {name: {**table.settings, **self.settings.get(table.name, {})}}
        if table != SolverTable():
            raise SweepError("solvers and [scenario.solver] are both given: keep solvers, set them in [settings]")
        names = runnable(self.solvers, BASELINE)
        if not names or len(set(names)) < len(names):
            raise SweepError(f"solvers = {names}: give one or more, each once")
        for name in self.settings:
            if name not in names:
                raise UnknownNameError("solver in [settings]", name, names)
        return {name: self.settings.get(name, {}) for name in names}


# --- the fields that may vary: those of a scenario, by dotted path ---


def paths(model: type[BaseModel] = Scenario, prefix: str = "") -> Iterator[tuple[str, bool]]:
    """Yield every field of a scenario, tables opened: its dotted path, and whether it takes names of its own."""
    for name, info in model.model_fields.items():
        kinds = [info.annotation, *get_args(info.annotation)]
        tables = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
        for table in tables:
            yield from paths(table, f"{prefix}{name}.")
        if not tables:
            yield f"{prefix}{name}", any(get_origin(kind) in (dict, Mapping) for kind in kinds)


def check_path(path: str) -> None:
    """Check that a path is that of a field which a sweep may vary.

    Raises:
        UnknownNameError: there is no such field; the message lists the nearest ones.
        SweepError: solver and seed, which have places of their own in the configuration.
    """
    if path in ELSEWHERE:
        raise SweepError(f"{path!r} cannot be swept as a field: give {ELSEWHERE[path]!r} in the configuration")
    known = dict(paths())
    table, _, key = path.rpartition(".")
    if path not in known and not (key and known.get(table, False)):
        raise UnknownNameError("scenario field", path, [*known, *(f"{p}.NAME" for p in known if known[p])])


def flatten(table: Mapping[str, Any], is_leaf: Callable[[Any], bool], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Flatten what TOML reads: ``control.c0 = ...`` is a table in a table, ``"control.c0" = ...`` one name."""
    for name, value in table.items():
        if isinstance(value, Mapping) and not is_leaf(value):
            yield from flatten(value, is_leaf, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def grid_axes(table: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return path -> values, all checked.

    Raises:
        UnknownNameError: no such field.
        SweepError: not a list of different values, or a field given twice.
    """
    axes: dict[str, list[Any]] = {}
    for path, values in flatten(table, lambda value: False):
        check_path(path)
        if path in axes:
            raise SweepError(f"[grid] {path} is given twice: keep one list")
        if not isinstance(values, list) or not values:
            raise SweepError(f"[grid] {path} = {values!r}: give a list of values")
        axes[path] = _different(f"[grid] {path}", values)
    return axes


def _different(where: str, values: list[Any]) -> list[Any]:
    texts = [f"{type(value).__name__} {value!r}" for value in values]
    for text in texts:
        if texts.count(text) > 1:
            raise SweepError(f"{where}: {text.partition(' ')[2]} is given twice: keep one, each value is one run")
    return values


def random_draws(table: Mapping[str, Any], samples: int, seed: int) -> dict[str, list[Any]]:
    """Return path -> ``samples`` values drawn by ``seed``.

    Each field has a stream of its own, named by its path: another field changes nothing in it, and more samples only
    lengthen it.

    Raises:
        UnknownNameError: no such field, or a key that no range has.
        SweepError: a range without width, or a logarithmic one that reaches zero.
    """
    draws: dict[str, list[Any]] = {}
    for path, entry in flatten(table, lambda value: bool({"low", "high", "choice"} & value.keys())):
        check_path(path)
        if path in draws:
            raise SweepError(f"[random.fields] {path} is given twice: keep one range")
        words = np.frombuffer(hashlib.sha256(path.encode()).digest(), dtype=np.uint32)
        uniform = np.random.default_rng([seed, *words.tolist()]).random(samples)
        try:
            draws[path] = _draw(entry, uniform)
        except SweepError as error:
            raise SweepError(f"[random.fields] {path}: {error}") from error
    return draws


def _draw(entry: Any, uniform: np.ndarray[Any, Any]) -> list[Any]:
    if not isinstance(entry, Mapping):
        raise SweepError(f"{entry!r}: give {{low = .., high = ..}} or {{choice = [..]}}")
    if "choice" in entry:
        options = _different("choice", Choice(**entry).choice)
        return [options[int(u * len(options))] for u in uniform]
    known = Range(**entry)
    low, high = known.low, known.high
    if not low < high:
        raise SweepError(f"low = {low:g} is not below high = {high:g}")
    if known.scale == "log":
        if low <= 0.0:
            raise SweepError(f"low = {low:g}: a logarithmic range begins above 0")
        exponents = math.log(low) + uniform * (math.log(high) - math.log(low))
        return [min(max(math.exp(e), low), high) for e in exponents]
    if known.scale == "integer":
        first, count = math.ceil(low), math.floor(high) - math.ceil(low) + 1
        if count < 1:
            raise SweepError(f"no whole number lies from {low:g} to {high:g}")
        return [first + int(u * count) for u in uniform]
    return [float(low + u * (high - low)) for u in uniform]


# --- the runs ---


def plan(config: Config) -> list[Trial]:
    """Return the runs: grid, then sample, then seed, then solver; what is the same run stands once.

    Raises:
        UnknownNameError: a field, solver or setting that does not exist.
        SweepError: values that no scenario can be made of, or too many runs.
    """
    grid, seeds, solvers = grid_axes(config.grid), config.chosen_seeds(), config.chosen_solvers()
    samples = config.random.samples if config.random.fields else 1
    count = math.prod([*map(len, grid.values()), samples, len(seeds), len(solvers)])
    if count > MOST_RUNS:  # before anything is drawn or listed
        raise SweepError(f"{count} runs: split what makes more than {MOST_RUNS} into several sweeps")
    draws = random_draws(config.random.fields, samples, config.seed)
    if twice := grid.keys() & draws.keys():
        raise SweepError(f"{min(twice)} stands in [grid] and in [random.fields]: keep one")
    found: dict[str, Trial] = {}
    for *values, sample, seed, solver in product(*grid.values(), range(samples), seeds, solvers):
        fields = dict(zip(grid, values, strict=True)) | {path: drawn[sample] for path, drawn in draws.items()}
        if solver == BASELINE:  # which asks no solver
            fields = {path: value for path, value in fields.items() if not path.startswith("solver.")}
        case = _case(config.scenario, seed, fields)
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
        table[last] = value
    try:
        return base.change(**changes)
    except MocOptError as error:
        if isinstance(unknown := error.__cause__ or error, UnknownNameError):
            raise unknown from None
        raise SweepError(f"seed = {seed}, {_words(fields)}: not a scenario: {error}") from error


def _words(fields: Mapping[str, Any]) -> str:
    return ", ".join(f"{path} = {value!r}" for path, value in fields.items())


def _check_names(runs: Sequence[Trial]) -> None:
    """Build what only a run would, once for every name: robots, paths, and solvers with their settings."""
    seen: set[tuple[str, Any]] = set()
    for run in runs:
        names = {("solver", run.controller)} | {(path, v) for path, v in run.tags.items() if isinstance(v, str)}
        if names <= seen:
            continue
        seen |= names
        try:
            Setup(variant(run.case, run.controller, run.settings)).controller()
        except MocOptError as error:
            for cause in (error, error.__cause__):
                if isinstance(cause, UnknownNameError):
                    raise cause from None
            # else a combination that cannot run: its row will say so


# --- the figures ---


def work(study: Study, config: Config) -> Found:
    """Do the runs that are not done yet, and summarise all of them."""
    asked = plan(config)
    rows = Results(run.row for run in study.trials(asked, limit_s=config.run_limit_s))
    axes = {path: values for path, values in grid_axes(config.grid).items() if len(values) > 1}
    summary: dict[str, Any] = {"all": grouped(rows)} | {f"by {path}": grouped(rows, path) for path in axes}
    lost = any(str(row["error"]).startswith(("hung", "crashed")) for row in rows.failed())
    return Found(report(summary, rows, axes, config), summary, rows, status=1 if lost else 0)


def grouped(rows: Results, field: str = "") -> dict[str, dict[str, Any]]:
    """Return "solver" or "solver, value of the field" -> counts, and each metric's mean, 5th and 95th percentile.

    Means are over the runs that completed their task.
    """
    found = {}
    for controller in rows.names():
        for value in rows.names(field) if field else [None]:
            mine = rows.where(controller=controller)
            mine = mine.where(**{field: value}) if field else mine
            if not len(mine):
                continue
            group: dict[str, Any] = {"runs": len(mine), "failed": len(mine.failed())}
            group["oscillated"] = sum(str(row["ended"]).startswith("oscillated") for row in mine)
            for metric in (*SHOWN, *TIMES):
                values = [row[metric] for row in mine if row.get("whole") and row.get(metric) is not None]
                if values:
                    low, high = np.percentile(values, (5, 95)).tolist()
                    group |= {metric: float(np.mean(values)), f"{metric}_p05": low, f"{metric}_p95": high}
            found[controller if value is None else f"{controller}, {value}"] = group
    return found


def report(summary: Mapping[str, Any], rows: Results, axes: Mapping[str, list[Any]], config: Config) -> Report:
    """Show the solvers first, then every field of the grid."""
    metrics = [*SHOWN, *(TIMES if config.timed else ())]

    def table(title: str, part: str, metrics: Sequence[str] = metrics) -> Table:
        shown = [{"group": name, **row} for name, row in summary[part].items()]
        link = EVERY if part == "all" else ""
        heads = columns("runs", "failed", *metrics, of=link, torque_rate_rms_Nm_per_s="chatter")
        return Table(title, [Column("group", "solver" if part == "all" else "solver, value"), *heads], shown,
                     "Means over the runs that completed their task.")  # fmt: skip

    mu = {name: row["mu_mean"] for name, row in summary["all"].items() if "mu_mean" in row}
    answer = [f"{len(rows)} runs, {len(rows.failed())} of them without a whole result."]
    if len(mu) > 1:
        best, worst = max(mu, key=mu.__getitem__), min(mu, key=mu.__getitem__)
        answer.append(f"Mean manipulability is between {mu[worst]:.4f} ({worst}) and {mu[best]:.4f} ({best}) m^3.")
    tables = [table(f"By solver and {path}", f"by {path}") for path in axes]
    sections = [Section(EVERY, "", [table("By solver", "all"), *tables])]
    title = f"Sweep over {', '.join([*axes, *config.random.fields]) or 'seeds'}"
    first = table("Every solver", "all", ("mu_mean", "tip_error_mean_mm", "rcm_error_mean_mm", "silently_wrong"))
    return Report(title, answer, first, pictures(summary, axes)[:3], sections)


def pictures(summary: Mapping[str, Any], axes: Mapping[str, list[Any]]) -> list[Picture]:
    """Draw metrics over every field of the grid that is a number: mean, 5th to 95th percentile."""
    found = []
    for field, values in axes.items():
        if not all(type(v) in (int, float) for v in values):
            continue
        for metric, words in PLOTTED.items():
            drawn, styles = figure(), Styles(summary["all"])
            for solver in summary["all"]:
                points = [(v, row) for v in sorted(values) if (row := summary[f"by {field}"].get(f"{solver}, {v}"))]
                points = [(v, row) for v, row in points if metric in row]
                if points:
                    drawn.add_scatter(
                        x=[v for v, _ in points], y=[row[metric] for _, row in points], name=solver,
                        mode="lines+markers", line={"color": styles[solver].color, "dash": styles[solver].dash},
                        error_y={"array": [row[f"{metric}_p95"] - row[metric] for _, row in points],
                                 "arrayminus": [row[metric] - row[f"{metric}_p05"] for _, row in points]},
                    )  # fmt: skip
            wide = min(values) > 0.0 and max(values) >= 30.0 * min(values)
            drawn.update_xaxes(title_text=field, type="log" if wide else "linear")
            drawn.update_yaxes(title_text=words)
            says = f"{words} over {field}: mean over all else, bars from the 5th to the 95th percentile."
            found.append(Picture(drawn, says, f"{metric}-{field}"))
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sweep; returns the exit status, 1 where a run hung or crashed."""
    return command("sweep", "Vary any field of a scenario, over solvers and seeds.", Config, work, arguments)


if __name__ == "__main__":
    sys.exit(main())
