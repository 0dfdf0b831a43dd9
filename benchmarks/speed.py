"""What everything costs, side by side in one run: ticks, solvers, adapters, the loop, set-up, and other libraries.

python -m benchmarks.speed [CONFIG.toml] [--out DIR] [--seed N] [--quick]
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence

from benchmarks.common import cli
from benchmarks.latency.config import Config
from benchmarks.latency.report import answer, report, tables
from benchmarks.latency.run import Run


def measure(given: Namespace) -> cli.Results:
    """Measure all parts."""
    config = Config.chosen(given, "speed")
    run = Run(config)
    with cli.steps("speed", run.steps()) as step:
        summary = run.measure(step)
    environment = config.environment(given)
    first = answer(summary, run.ticks)
    shown = [table for name, table in tables(summary).items() if name in ("tick", "peers")]
    return cli.Results(summary, environment, run.rows, report(summary, first, environment), shown, answer=first)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    return cli.run(cli.parser("speed", "Measure what everything costs."), measure, arguments)


if __name__ == "__main__":
    sys.exit(main())
