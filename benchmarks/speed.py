"""What everything costs, side by side in one run: ticks, solvers, adapters, the loop, set-up, and other libraries.

python -m benchmarks.speed [CONFIG.toml] [--out DIR] [--seed N] [--quick]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import output
from benchmarks.latency.config import Config
from benchmarks.latency.report import print_tables, write_report
from benchmarks.latency.run import Run
from moc_opt.errors import MocOptError
from moc_opt.report.console import console, progress


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure everything; 0, or 2 with a message where the input is wrong."""
    given = output.parser("speed", "Measure what everything costs.").parse_args(arguments)
    try:
        config = Config.chosen(given, "speed")
        if given.quick:
            config = config.quick()
        measure(config, given.out, given.json, list(arguments or sys.argv[1:]))
    except MocOptError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    return 0


def measure(config: Config, out: Path, as_json: bool, argv: list[str]) -> dict[str, Any]:
    """All parts, all files; returns the summary."""
    run = Run(config)
    with progress("speed", run.steps()) as bar:

        def advance(text: str) -> None:
            bar.at(text)
            bar.advance()

        summary = run.measure(advance)
    environment = output.environment(config.model_dump(mode="json"), config.seed, argv)
    output.write_json(out / "summary.json", summary)
    output.write_rows(out / "rows.parquet", run.rows)
    output.write_json(out / "environment.json", environment)
    write_report(out / "report.html", summary, run.ticks, environment)
    if as_json:
        print((out / "summary.json").read_text(), end="")
    else:
        print_tables(console(), summary, out)
    return summary


if __name__ == "__main__":
    sys.exit(main())
