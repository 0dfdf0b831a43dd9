"""The main job, as `moc-opt solvers` and `make solvers` run it, with the ranking of qpbenchmark beside ours as a part.

python -m benchmarks.solvers [CONFIG.toml] [--out DIR] [--seed N] [--quick | --full] [--only SOLVER ...]
                             [--sets NAME ...] [--parts PART ...]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from benchmarks.export import beside_ours
from moc_opt.study import solvers


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; returns the exit status."""
    return solvers.main(arguments, more={"qpbenchmark": beside_ours}, program="python -m benchmarks.solvers")


if __name__ == "__main__":
    sys.exit(main())
