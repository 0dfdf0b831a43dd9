"""The pictures of the README: python -m benchmarks.pictures [--out DIR]."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from moc_opt import figures
from moc_opt.report.export import save_figures
from moc_opt.scenario import Scenario, run


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pictures", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs") / "pictures")
    given = parser.parse_args(arguments)
    trial = Scenario(seed=1, start={"swivel": "random"}, control={"preset": "tuned"}, bound_samples=40)
    runs = {
        "dcac, same gains": trial.change(control=trial.control.matched_dcac()),
        "moc, exact": trial,
        "moc, rnn": trial.change(solver={"name": "rnn", "settings": {}}),
        "moc, rnn-printed": trial.change(solver={"name": "rnn-printed", "settings": {}}),
    }
    found = {name: run(scenario) for name, scenario in runs.items()}
    drawn = figures.time_series(found)
    drawn.update_layout(legend_entrywidth=150)
    for path in save_figures({"trial": drawn}, given.out, formats=("svg",)):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
