"""The pictures of the README: python -m benchmarks.pictures [--out DIR]."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common import cli
from moc_opt import figures
from moc_opt.report.export import save_figures
from moc_opt.scenario import Scenario, run


def draw(given: argparse.Namespace) -> int:
    """Draw one trial under the controllers, as SVG."""
    trial = Scenario(seed=1, start={"swivel": "random"}, control={"preset": "tuned"}, bound_samples=40)
    runs = {
        "dcac, same gains": trial.change(control=trial.control.matched_dcac()),
        "moc, exact": trial,
        "moc, rnn": trial.change(solver={"name": "rnn", "settings": {}}),
        "moc, rnn-printed": trial.change(solver={"name": "rnn-printed", "settings": {}}),
    }
    found = {name: run(scenario) for name, scenario in runs.items()}
    for path in save_figures({"trial": figures.time_series(found)}, given.out, formats=("svg",)):
        print(path)
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw; see `cli.run` for the exit status, which is 2 where no browser is there."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pictures", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs") / "pictures")
    return cli.run(parser, draw, arguments)


if __name__ == "__main__":
    sys.exit(main())
