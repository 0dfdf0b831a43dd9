"""The solver study, which `moc-opt solvers` and `make solvers` also run.

python -m benchmarks.solvers [CONFIG.toml] [--out DIR] [--seed N] [--quick | --full] [--only SOLVER ...]
                             [--sets NAME ...] [--parts PART ...]
"""

from __future__ import annotations

import sys
from functools import partial

from moc_opt.study import solvers

main = partial(solvers.main, program="python -m benchmarks.solvers")

if __name__ == "__main__":
    sys.exit(main())
