"""How many small errors in the source do the tests find?

python -m benchmarks.mutation [CONFIG.toml] [--out DIR] [--seed N] [--sample N] [--module NAME ...] [--quick]

Mutates the control law, its guard, supervisor, the residuals of answers and a period of the plant one place at a time
and runs the tests on each mutant. Nothing is written into the tree. Needs cosmic-ray: pip install 'moc-opt[mutation]'.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration
from benchmarks.maintenance.mutants import trial
from benchmarks.maintenance.mutants.make import Mutant, MutationError, places, sample
from moc_opt.errors import UnknownNameError
from moc_opt.inputs.settings import Settings
from moc_opt.report.tables import Column, Table

ROOT = Path(__file__).resolve().parents[2]
BASELINE_S = 900.0
KINDS = ("killed", "timed_out", "survived", "equivalent")


class Equivalent(Settings):
    """A mutant that no test can tell from the source, and why."""

    KIND: ClassVar[str] = "[[equivalent]]"
    module: str
    before: str = Field(description="the line, without its indentation")
    after: str = Field(description="what the mutant makes of it")
    why: str = Field(min_length=20)


class Config(Configuration):
    """benchmarks/configs/mutation.toml."""

    sample: int = Field(240, ge=1)
    limit_s: float = Field(60.0, gt=0.0)
    patience: float = Field(8.0, ge=2.0)
    slowest_s: float = Field(5.0, gt=0.0)
    share_wanted: float = Field(0.95, gt=0.0, le=1.0)
    modules: dict[str, Annotated[list[str], Field(min_length=1)]] = Field(min_length=1)
    equivalent: tuple[Equivalent, ...] = ()

    def quick(self) -> Self:
        """Take eight mutants alone."""
        return self.model_copy(update={"sample": 8})

    def choosing(self, names: Sequence[str] | None, count: int | None) -> Self:
        """Take these modules alone, and that many mutants.

        Raises:
            UnknownNameError: a module that the configuration does not name.
            MutationError: fewer than one mutant.
        """
        for name in names or ():
            if name not in self.modules:
                raise UnknownNameError("module", name, self.modules)
        if count is not None and count < 1:
            raise MutationError(f"--sample {count}: give 1 or more")
        kept = {name: tests for name, tests in self.modules.items() if not names or name in names}
        return self.model_copy(update={"modules": kept, "sample": count or self.sample})


def draw(config: Config) -> tuple[dict[str, int], list[Mutant]]:
    """Tell how many places for a mutation each module has, and a seeded sample over all of them."""
    every = {name: places(ROOT, name) for name in config.modules}
    pooled = [place for found in every.values() for place in found]
    chosen = sample(ROOT, pooled, config.sample, np.random.default_rng(config.seed))
    return {name: len(found) for name, found in every.items()}, chosen


def usable_tests(config: Config, module: str, plain: Collection[str]) -> tuple[dict[str, float], dict[str, str]]:
    """Return the tests of a module that pass on its source as it is, with their seconds; those left out, and why.

    Raises:
        MutationError: they take too long, or none is left.
    """
    found = trial.run_tests(ROOT, module, None, plain, config.modules[module], BASELINE_S, keep_going=True)
    if found.result == "timed out":
        raise MutationError(f"{module}: its tests take longer than {BASELINE_S:g} s without any mutation")
    fails = "fails where kernels are plain Python" if plain else "fails"
    left_out = {
        name: f"takes {seconds:.0f} s" if passed else fails
        for name, (passed, seconds) in found.tests.items()
        if not passed or seconds > config.slowest_s
    }
    # The quick ones first: most mutants do not live to see the others.
    ranked = sorted((seconds, name) for name, (_, seconds) in found.tests.items() if name not in left_out)
    if not ranked:
        raise MutationError(f"{module}: no test of {', '.join(config.modules[module])} passes without a mutation")
    return {name: seconds for seconds, name in ranked}, left_out


def try_mutants(
    config: Config, module: str, chosen: Sequence[Mutant], advance: Callable[[str], None]
) -> dict[str, Any]:
    """Try all mutants of one module; return what became of them."""
    known = {(entry.before, entry.after): entry.why for entry in config.equivalent if entry.module == module}
    counts = dict.fromkeys(KINDS, 0)
    survivors: list[dict[str, Any]] = []
    equivalent: list[dict[str, Any]] = []
    found_by: dict[str, int] = {}
    usable: dict[frozenset[str], tuple[dict[str, float], dict[str, str]]] = {}
    for mutant in chosen:
        plain = trial.may_hold(ROOT, module, mutant.line)
        if plain not in usable:
            usable[plain] = usable_tests(config, module, plain)
        tests = usable[plain][0]
        limit_s = max(config.limit_s, config.patience * sum(tests.values()))
        outcome = trial.run_tests(ROOT, module, mutant.source, plain, list(tests), limit_s)
        if outcome.result != "survived":
            counts[outcome.result.replace(" ", "_")] += 1
            found_by[outcome.by or "time limit"] = found_by.get(outcome.by or "time limit", 0) + 1
        elif (why := known.get((mutant.before, mutant.after))) is not None:
            counts["equivalent"] += 1
            equivalent.append({**mutant.row(), "why": why})
        else:
            counts["survived"] += 1
            survivors.append(mutant.row())
        advance(f"{module}:{mutant.line}")
    return {
        **counts, **shares(counts), "survivors": survivors, "equivalents": equivalent, "found_by": found_by,
        "tests": [
            {"used": len(tests), "left_out": left_out, "kernels": "plain Python" if plain else "compiled"}
            for plain, (tests, left_out) in usable.items()
        ],
    }  # fmt: skip


def shares(counts: Mapping[str, int]) -> dict[str, float | None]:
    """Compute the share found of all mutants, and of all but the equivalent ones; a time limit counts as found."""
    found = counts["killed"] + counts["timed_out"]
    real = found + counts["survived"]
    every = real + counts["equivalent"]
    return {"share_of_all": found / every if every else None, "share_found": found / real if real else None}


def total(modules: Mapping[str, Mapping[str, Any]], wanted: float) -> dict[str, Any]:
    """Sum counts and shares over all modules."""
    counts = {kind: sum(row[kind] for row in modules.values()) for kind in KINDS}
    found = shares(counts)
    share = found["share_found"]
    return {**counts, **found, "wanted": wanted, "reached": share is not None and share >= wanted}


def table(summary: Mapping[str, Any]) -> Table:
    """Make the table: a line a module, and the total."""
    counts = ("places", "tried", *KINDS)
    columns = [Column("module", "module"), *(Column(name, name.replace("_", " "), format="d") for name in counts)]
    rows = [
        {
            "module": name, **row, "tried": sum(row[kind] for kind in KINDS),
            "percent": None if row["share_found"] is None else 100.0 * row["share_found"],
        }
        for name, row in [*summary["modules"].items(), ("all", summary["total"])]
    ]  # fmt: skip
    return Table("mutants", [*columns, Column("percent", "share found", unit="%", format=".1f")], rows)


def run(given: Namespace) -> cli.Results:
    """Try every mutant of the sample."""
    config = Config.chosen(given, "mutation").choosing(given.module, None if given.quick else given.sample)
    numbers, chosen = draw(config)
    modules: dict[str, Any] = {}
    with cli.steps("mutation", len(chosen)) as step:
        for name in config.modules:
            mine = [mutant for mutant in chosen if mutant.module == name]
            if mine:
                modules[name] = {"places": numbers[name], **try_mutants(config, name, mine, step)}
    summary = {"modules": modules, "total": total(modules, config.share_wanted)}
    survivors = [
        f"{name}:{row['line']} {row['operator']}\n    {row['before']}\n    {row['after']}"
        for name, found in modules.items()
        for row in found["survivors"]
    ]
    return cli.Results(summary, config.environment(given), tables=[table(summary)], sentences=survivors)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("mutation", "Count the small errors in the source that the tests find.")
    options.add_argument("--sample", type=int, metavar="N", help="mutants in all, instead of the configuration's")
    options.add_argument("--module", nargs="+", metavar="NAME", help="these modules alone")
    return cli.run(options, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
