"""Export the test sets as DIR/null_space.py and DIR/null_space.parquet for qpbenchmark (2.7.1 or later).

    python -m benchmarks.export qpbenchmark --out DIR [--sets NAME ...] [--every K] [--rows 5|6]
    qpbenchmark DIR/null_space.py --results-path DIR/results.csv run --author NAME
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from moc_opt.errors import MocOptError, StudyError
from moc_opt.inputs.files import write_whole
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.study.command import WRONG
from moc_opt.study.testsets import TestSet, check_name

NAME = "null_space"
SETS = ("circle", "circle-rho0", "random", "joint-limits", "near-singular", "jumps")
SECONDS = 0.1  # time limit of a solve in qpbenchmark

MODULE = '''"""{title}: {count} subproblems of a manipulability controller, each of them feasible.

Written by: python -m benchmarks.export qpbenchmark
"""

from pathlib import Path

from qpbenchmark import ParquetTestSet


class NullSpace(ParquetTestSet):
    """Subproblems of {joints} joints and {rows} equality rows, from the test sets {sets}."""

    description = "The null-space subproblem of a surgical arm at one control tick. Its costs are below 1e-3."
    title = "{title}"
    sparse_only = False

    def __init__(self):
        super().__init__(Path(__file__).with_suffix(".parquet"))

    def define_tolerances(self, runtime={seconds}):
        super().define_tolerances(runtime)
'''


def problems(names: Sequence[str], every: int = 1) -> dict[str, NullSpaceQP]:
    found = {}
    for name in names:
        check_name(name)
        kept = TestSet.load(name)
        for index in range(0, len(kept.rows), every):
            if kept.feasible[index]:
                found[f"{name.replace('-', '_').upper()}_{index:03d}"] = NullSpaceQP.from_row(kept.rows[index].copy())
    return found


def write_qpbenchmark(folder: Path, names: Sequence[str] = SETS, every: int = 1, rows: int = 5) -> Path:
    """Write a Parquet file in the format of qpbenchmark's ``ProblemList``, and a module that loads it."""
    chosen = problems(names, every)
    if not chosen:
        raise StudyError(f"sets = {', '.join(names)}: no problem in them is feasible; use other sets")
    table: dict[str, list[Any]] = {key: [] for key in ("P", "q", "G", "h", "A", "b", "lb", "ub", "name")}
    for name, qp in chosen.items():
        P, p, A, b, _ = qp.assembled(rows)
        values = {"P": P, "q": p, "A": A, "b": b, "lb": qp.lower, "ub": qp.upper}
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


def main(arguments: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(prog="python -m benchmarks.export", description="Export the test sets.")
    options.add_argument("format", choices=["qpbenchmark"])
    options.add_argument("--out", type=Path, required=True, help="folder for the files")
    options.add_argument("--sets", nargs="+", metavar="NAME", default=list(SETS), help="test sets")
    options.add_argument("--every", type=int, default=1, help="take every N-th problem")
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
