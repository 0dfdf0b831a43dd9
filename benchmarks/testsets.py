"""Make the certified test sets of the subproblem again, or compare them with the files.

python -m benchmarks.testsets [--check]

The same seed gives the same problems, on one machine to the last bit; those of the sequences, which were recorded in
closed loop, are taken from the files. Compared are the problems made here with those of the files, and the answers in
the files with the certificate of the same problems.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.subproblems.certify import certify, make
from benchmarks.subproblems.recipes import RECIPES
from moc_opt.inputs.files import write_whole
from moc_opt.robots.model import load_robot
from moc_opt.study.testsets import FOLDER, TestSet

CLOSE = 1e-9  # rad/s; another machine rounds the five rows in other directions, which moves an optimum by 1e-14


def main(arguments: Sequence[str] | None = None) -> int:
    """Make or check all sets; returns the exit status, 1 where the files differ."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.testsets", description=__doc__)
    options.add_argument("--check", action="store_true", help="compare with the files instead of writing")
    return make_all(options.parse_args(arguments).check)


def make_all(check: bool) -> int:
    robot, different = load_robot(), []
    for name in RECIPES:
        made = make(name, robot)
        print(f"{name:20s} {len(made.rows):4d} problems, {int(made.feasible.sum()):4d} feasible", end="")
        if not check:
            print()
            write_whole(FOLDER / f"{name}.npz", made.to_bytes())
            continue
        kept = TestSet.load(name)
        again = certify(name, kept.problems())
        apart = float(np.nanmax(np.abs(again.x - kept.x), initial=0.0))
        print(f", answers in the file within {apart:.1e} rad/s of the certificate")
        same = np.allclose(kept.rows, made.rows, rtol=1e-9, atol=1e-12, equal_nan=True)
        if not (same and np.array_equal(again.feasible, kept.feasible) and apart <= CLOSE):
            different.append(name)
    if different:
        print(f"not what this program makes: {', '.join(different)}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
