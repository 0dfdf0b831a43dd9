"""Make the certified test sets of the subproblem again (same seed, same bytes), or compare them with the files.

python -m benchmarks.testsets [--check]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.common import cli
from benchmarks.common.output import write_atomically
from benchmarks.subproblems.certify import make
from benchmarks.subproblems.recipes import RECIPES
from benchmarks.subproblems.testset import FOLDER, TestSet
from moc_opt.model.robot_model import load_robot
from moc_opt.qp.problem import compute_residuals


def main(arguments: Sequence[str] | None = None) -> int:
    """Make or check all sets; see `cli.run` for the exit status, which is 1 where the files differ."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.testsets", description=__doc__)
    options.add_argument("--check", action="store_true", help="compare with the files instead of writing")
    return cli.run(options, _make_all, arguments)


def _make_all(given: argparse.Namespace) -> int:
    robot, different = load_robot(), []
    for name in RECIPES:
        made = make(name, robot)
        found = compute_residuals(made.rows, made.x)
        print(f"{name:20s} {len(made.rows):4d} problems, {int(made.feasible.sum()):4d} feasible, "
              f"largest primal residual {np.max(found.primal[made.feasible], initial=0.0):.1e}")  # fmt: skip
        if not given.check:
            write_atomically(FOLDER / f"{name}.npz", made.to_bytes())
            continue
        kept = TestSet.load(name)
        if not np.allclose(kept.rows, made.rows, rtol=1e-9, atol=1e-12, equal_nan=True):
            different.append(name)
    if different:
        print(f"not what this program makes: {', '.join(different)}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
