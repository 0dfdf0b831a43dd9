"""The test sets for qpbenchmark (2.7.1 or later), and its ranking of solvers.

    python -m benchmarks.export qpbenchmark --out DIR [--sets NAME ...] [--every K] [--rows 5|6]

writes DIR/null_space.py and DIR/null_space.parquet, a test set that qpbenchmark runs as it is:

    qpbenchmark DIR/null_space.py --results-path DIR/results.csv run --author NAME

The measures of its report are computed here from its rows, as it prints them only.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from moc_opt.errors import MocOptError
from moc_opt.inputs.files import write_whole
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.report.tables import Column, Table
from moc_opt.study.command import WRONG
from moc_opt.study.show import Section
from moc_opt.study.solver_answers import share_right
from moc_opt.study.solver_settings import QPSOLVERS
from moc_opt.study.solvers import Work
from moc_opt.study.testsets import TestSet, check_name

NAME = "null_space"
SETS = ("circle", "circle-rho0", "random", "joint-limits", "near-singular", "jumps")
TOLERANCES = {"default": 1.0, "high_accuracy": 1e-9}
"""Their settings -> within which a solve succeeds in their report."""
SECONDS = 0.1  # a solve may take this long there: a thousand times what most solvers need
SHIFT_S, MARGIN_S = 10.0, 600.0
OURS = {"default": "default", "high_accuracy": "tight"}
"""Their settings -> ours."""
COLUMNS = [
    Column("solver", "solver"), Column("rank", "their rank"),
    Column("success_percent", "success", unit="%", format=".0f", better="high"),
    Column("shgeom_us", "their mean", unit="us", digits=4, better="low", help="shifted geometric mean, shift 10 s"),
    Column("runtime_p50_us", "their p50", unit="us", format=".1f", better="low"),
    Column("our_p50_us", "our p50", unit="us", format=".1f"),
    Column("our_right_percent", "right by us", unit="%", format=".1f", better="high"),
    Column("reason", "not run because"),
]  # fmt: skip

MODULE = '''"""{title}: {count} subproblems of a manipulability controller, each of them feasible.

Written by: python -m benchmarks.export qpbenchmark
"""

from pathlib import Path

from qpbenchmark import ParquetTestSet


class NullSpace(ParquetTestSet):
    """Subproblems of {joints} joints and {rows} equality rows, from the test sets {sets}."""

    description = "The null-space subproblem of a surgical arm at one control tick: small, with costs of 1e-4."
    title = "{title}"
    sparse_only = False

    def __init__(self):
        super().__init__(Path(__file__).with_suffix(".parquet"))

    def define_tolerances(self, runtime={seconds}):
        super().define_tolerances(runtime)
'''


class ExportError(MocOptError, RuntimeError):
    """A test set cannot be handed over."""


def problems(names: Sequence[str], every: int = 1) -> dict[str, NullSpaceQP]:
    """Map name to each every-th problem of those sets that has an answer."""
    found = {}
    for name in names:
        check_name(name)
        kept = TestSet.load(name)
        for index in range(0, len(kept.rows), every):
            if kept.feasible[index]:
                found[f"{name.replace('-', '_').upper()}_{index:03d}"] = NullSpaceQP.from_row(kept.rows[index].copy())
    return found


def write_qpbenchmark(folder: Path, names: Sequence[str] = SETS, every: int = 1, rows: int = 5) -> Path:
    """Write the two files; returns the module's path.

    qpbenchmark counts an unsolved problem against a solver, so problems without an answer are left out. The format
    is that of its ``ProblemList``: matrices by rows in flat columns.
    """
    chosen = problems(names, every)
    if not chosen:
        raise ExportError(f"sets = {', '.join(names)}: no problem in them is feasible; take other sets")
    table: dict[str, list[Any]] = {key: [] for key in ("P", "q", "G", "h", "A", "b", "lb", "ub", "name")}
    for name, qp in chosen.items():
        A, b = (qp.A, qp.b) if rows == 6 else qp.reduced()[:2]
        values = {"P": qp.P, "q": qp.p, "A": A, "b": b, "lb": qp.lower, "ub": qp.upper}
        for key in table:
            table[key].append(name if key == "name" else np.ravel(values[key]).tolist() if key in values else None)
    frame = pl.DataFrame(table, schema={key: pl.String if key == "name" else pl.List(pl.Float64) for key in table})
    folder.mkdir(parents=True, exist_ok=True)
    frame.write_parquet(folder / f"{NAME}.parquet")
    text = MODULE.format(
        title="Null-space subproblems", count=len(chosen), rows=rows, sets=", ".join(names), seconds=SECONDS,
        joints=next(iter(chosen.values())).n,
    )  # fmt: skip
    module = folder / f"{NAME}.py"
    write_whole(module, text.encode())
    return module


def run_qpbenchmark(module: Path, solver: str = "") -> pl.DataFrame:
    """Let qpbenchmark run a test set in a process of its own, under all settings; the rows of its results.

    Args:
        module: the test set's Python file; results and report are written beside it.
        solver: as qpsolvers spells it; "": all that it finds.
    """
    if find_spec("qpbenchmark") is None:
        raise ExportError("qpbenchmark is not installed: pip install 'moc-opt[qpbenchmark]'")
    results = module.with_name("results.csv")
    results.unlink(missing_ok=True)
    command = [sys.executable, "-m", "qpbenchmark.benchmark", str(module), "--results-path", str(results), "run"]
    command += ["--author", "moc_opt", *(["--solver", solver] if solver else [])]
    try:
        subprocess.run(command, capture_output=True, text=True, timeout=MARGIN_S, check=True)
    except subprocess.CalledProcessError as error:
        raise ExportError(f"qpbenchmark {solver} failed: {error.stderr[-500:]}") from error
    except subprocess.TimeoutExpired as error:
        raise ExportError(f"qpbenchmark {solver} took more than {MARGIN_S:g} s: {error}") from error
    return pl.read_csv(results, infer_schema_length=None)


def ranking(folder: Path, every: int = 16) -> dict[str, dict[str, Any]]:
    """Ask qpbenchmark for its ranking of each every-th problem: solver@settings -> figures, or why there is none."""
    try:
        return figures(run_qpbenchmark(write_qpbenchmark(folder, every=every)))
    except ExportError as error:
        return {"none": {"reason": str(error)}}


def figures(rows: pl.DataFrame) -> dict[str, dict[str, Any]]:
    """Compute qpbenchmark's measures: success in percent, shifted geometric mean of run times, and ranks.

    As in its report: the shift is 10 s, a failure counts as the time limit, and a solve succeeds within its tolerances.
    """
    limit = pl.col("settings").replace_strict(TOLERANCES, default=None)
    right = [pl.col(name) < limit for name in ("primal_residual", "dual_residual", "duality_gap")]
    time = pl.when("found").then("runtime").otherwise(SECONDS)
    found = (
        rows.filter(pl.col("settings").is_in(list(TOLERANCES)))
        .group_by("settings", "solver")
        .agg(
            pl.len().alias("problems"),
            (100.0 * pl.all_horizontal("found", *right).fill_null(False).mean()).alias("success_percent"),
            (1e6 * ((time + SHIFT_S).log().mean().exp() - SHIFT_S)).alias("shgeom_us"),
            (1e6 * time.median()).alias("runtime_p50_us"),
        )
        .with_columns(pl.col("shgeom_us").rank("ordinal").over("settings").alias("rank"))
        .sort("settings", "rank")
    )
    return {f"{row.pop('solver')}@{row.pop('settings')}": row for row in found.to_dicts()}


def beside_ours(work: Work) -> None:
    """Add qpbenchmark's ranking of the libraries to the solver study, with our figures of them beside it."""
    found = work.summary["qpbenchmark"] = ranking(work.study.out / "qpbenchmark")
    ours = {
        label.removeprefix(QPSOLVERS): row for label, row in work.summary.get("testsets", {}).items()
        if label.startswith(QPSOLVERS) and row.get("solves")
    }  # fmt: skip
    rows = []
    for label, theirs in found.items():
        solver, _, settings = label.partition("@")
        mine = ours.get(f"{solver}@{OURS.get(settings, '')}", {})
        rows.append({
            "solver": label, **theirs, "our_p50_us": mine.get("solve_p50_us_worst_set"),
            "our_right_percent": 100.0 * share_right(mine) if mine else None,
        })  # fmt: skip
    table = Table("The ranking of qpbenchmark, and our figures of the same libraries", COLUMNS, rows,
                  "Theirs: on feasible problems of six sets, five rows; ours: the same library and settings on all "
                  "certified sets. With times of microseconds and a shift of 10 s their geometric mean is an "
                  "arithmetic one.")  # fmt: skip
    work.sections.append(Section("What qpbenchmark says", "", [table]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a test set; returns the exit status."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.export", description="The test sets for others.")
    options.add_argument("format", choices=["qpbenchmark"])
    options.add_argument("--out", type=Path, required=True, help="folder for the files")
    options.add_argument("--sets", nargs="+", metavar="NAME", default=list(SETS), help="test sets")
    options.add_argument("--every", type=int, default=1, help="take each every-th problem")
    options.add_argument("--rows", type=int, choices=[5, 6], default=5, help="equality rows")
    given = options.parse_args(arguments)
    try:
        module = write_qpbenchmark(given.out, given.sets, max(1, given.every), given.rows)
    except (MocOptError, OSError) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return WRONG
    print(f"written: {module} and {module.with_suffix('.parquet').name}; run it with")
    print(f"  qpbenchmark {module} --results-path {module.with_name('results.csv')} run --author NAME")
    return 0


if __name__ == "__main__":
    sys.exit(main())
