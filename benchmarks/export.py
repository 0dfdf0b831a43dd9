"""The test sets in other people's formats.

    python -m benchmarks.export qpbenchmark --out DIR [--sets NAME ...] [--every K] [--rows 5|6]

writes DIR/null_space.py and DIR/null_space.parquet, a test set that qpbenchmark (2.7.1 or later) runs as it is:

    qpbenchmark DIR/null_space.py --results-path DIR/results.csv run --author NAME
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.subproblems.qpbenchmark import SETS, write_qpbenchmark
from moc_opt.errors import MocOptError
from moc_opt.study.command import WRONG


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
