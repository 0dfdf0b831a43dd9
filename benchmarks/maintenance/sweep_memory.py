"""Memory against rows: the summary of a sweep, on synthetic tables of growing length.

python -m benchmarks.sweep_memory [--rows N ...] [--out DIR] [--json]
"""

from __future__ import annotations

import json
import sys
import tempfile
from argparse import SUPPRESS, Namespace
from collections.abc import Sequence
from pathlib import Path
from subprocess import PIPE, run
from time import perf_counter
from typing import Any

import numpy as np
import pyarrow as pa

from benchmarks.common import cli, output
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.errors import SweepError
from benchmarks.sweeps.plan import Plan
from benchmarks.sweeps.table import BLOCK, rows_schema, whole_parquet
from moc_opt.inputs.files import to_json
from moc_opt.report.tables import Column, Table

ROWS = (10_000, 100_000, 1_000_000)
SOLVERS = ("dcac", "exact", "osqp", "rnn")
COLUMNS = [
    Column("rows", "rows", format="d"),
    Column("file_MB", "file", unit="MB", format=".1f"),
    Column("before_MB", "before", unit="MB", format=".0f", help="peak memory of the process, libraries loaded"),
    Column("peak_MB", "peak", unit="MB", format=".0f", help="peak memory of the process, summary made"),
    Column("growth_MB", "growth", unit="MB", format=".1f", better="low", help="what the summary added to the peak"),
    Column("seconds", "time", unit="s", format=".2f"),
]


def write_synthetic(folder: Path, rows: int, seed: int = 0) -> Path:
    """Return rows.parquet as a sweep leaves it, with log-normal figures; itself in constant memory."""
    plan = Plan(Config(solvers=list(SOLVERS), grid={"control.regularization": [1e-6, 1e-5, 1e-4]}))
    schema, rng = rows_schema(plan), np.random.default_rng(seed)
    path = folder / "rows.parquet"
    with whole_parquet(path, schema) as write:
        for first in range(0, rows, BLOCK):
            index = np.arange(first, min(first + BLOCK, rows))
            known = {
                "index": index, "run": [f"{i:020x}" for i in index], "seed": index // 12,
                "solver": [SOLVERS[i % 4] for i in index],
                "control.regularization": np.array([1e-6, 1e-5, 1e-4])[index // 4 % 3],
                "ended": ["completed" if i % 97 else "failed" for i in index],
                "error": [None if i % 97 else "SolverError: made up" for i in index],
            }  # fmt: skip
            columns = [known.get(name, rng.lognormal(size=len(index))) for name in schema.names]
            write(pa.table([pa.array(c, f.type) for c, f in zip(columns, schema, strict=True)], schema=schema))
    return path


def peak_MB() -> float:
    """Return the largest resident memory of this process so far [MB]."""
    # Not getrusage: its figure survives exec, so a child would begin with its parent's.
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    raise SweepError("this system does not tell the peak memory of a process (/proc/self/status has no VmHWM)")


def measure(folder: Path) -> dict[str, float]:
    """Summarise a folder in this process, which should be a fresh one."""
    from benchmarks.sweeps.summary import summarise

    before, begin = peak_MB(), perf_counter()
    summarise(folder, ["solver", "control.regularization"])
    after = peak_MB()
    return {
        "before_MB": before, "peak_MB": after, "growth_MB": after - before, "seconds": perf_counter() - begin,
    }  # fmt: skip


def grow(given: Namespace) -> cli.Results | int:
    """Measure each length in a process of its own."""
    if given.one is not None:
        print(to_json(measure(given.one), indent=None))
        return 0
    found: list[dict[str, Any]] = []
    for rows in given.rows:
        with tempfile.TemporaryDirectory() as folder:
            size = write_synthetic(Path(folder), rows).stat().st_size
            command = [sys.executable, "-m", "benchmarks.maintenance.sweep_memory", "--one", folder]
            answer = run(command, stdout=PIPE, check=False, text=True)
            if answer.returncode:
                raise SweepError(f"the process that should summarise {rows} rows ended with {answer.returncode}")
            found.append({"rows": rows, "file_MB": size / 2**20, **json.loads(answer.stdout)})
    summary = {"memory": {str(row["rows"]): row for row in found}}
    environment = output.environment({"rows": given.rows}, 0, given.argv)
    return cli.Results(summary, environment, tables=[Table("Memory of a summary", COLUMNS, found)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the measurement; see `cli.run` for the exit status."""
    options = cli.parser("sweep_memory", "Memory of a sweep's summary against rows.", configured=False)
    options.add_argument("--rows", type=int, nargs="+", default=list(ROWS), metavar="N")
    options.add_argument("--one", type=Path, help=SUPPRESS)
    return cli.run(options, grow, arguments)


if __name__ == "__main__":
    sys.exit(main())
