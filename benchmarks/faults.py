"""Every fault under every controller: survived, or stopped safely?

python -m benchmarks.faults [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--page]

--page also writes docs/reliability.md, and docs/reliability.json with the figures in it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import output
from benchmarks.parallel import run_parallel
from benchmarks.reliability.config import Config
from benchmarks.reliability.page import PAGE, write_page
from benchmarks.reliability.report import print_tables, write_report
from benchmarks.reliability.runs import jobs, run_job
from benchmarks.reliability.summary import goals, summarise
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.report.console import console, progress
from moc_opt.solvers import available


def check_solvers(config: Config) -> None:
    """Every solver must be there before the first run.

    Raises:
        UnknownNameError: no such solver.
        MocOptError: it cannot run here, and why.
    """
    found = available()
    for name in config.solvers:
        if name not in found:
            raise UnknownNameError("solver", name, found)
        if found[name] is not None:
            raise MocOptError(f"solver {name!r} cannot run here: {found[name]}")


def inject(config: Config, out: Path, as_json: bool, argv: list[str]) -> dict[str, Any]:
    """Everything, all files; returns the summary."""
    work = jobs(config)
    with progress("faults", len(work)) as bar:
        outcomes = run_parallel(run_job, work, config.processes, lambda: bar.advance(1.0))
    rows = [row for outcome in outcomes for row in outcome.rows]
    traces = {name: trace for outcome in outcomes for name, trace in outcome.traces.items()}
    cases = summarise(rows)
    reached = goals(config, cases)
    environment = output.environment(config.model_dump(mode="json"), config.seed, argv)
    shared = config.processes > 1
    environment["timing"] = f"shared: {config.processes} processes at a time" if shared else "one process"
    summary: dict[str, Any] = {**cases, "goals": {goal["goal"]: goal for goal in reached}}
    output.write_json(out / "summary.json", summary)
    output.write_rows(out / "rows.parquet", rows)
    output.write_json(out / "environment.json", environment)
    write_report(out / "report.html", cases, reached, traces, environment)
    if as_json:
        print((out / "summary.json").read_text(), end="")
    else:
        print_tables(console(), cases, reached, out)
    return {"cases": cases, "goals": reached, "environment": environment}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0, or 2 with a message where the input is wrong."""
    options = output.parser("faults", "Inject every fault under every controller.")
    options.add_argument("--page", action="store_true", help=f"write {PAGE.parent.name}/{PAGE.name} as well")
    given = options.parse_args(arguments)
    argv = sys.argv[1:] if arguments is None else list(arguments)
    try:
        config = Config.chosen(given, "faults")
        if given.quick:
            config = config.quick()
        check_solvers(config)
        found = inject(config, given.out, given.json, argv)
        if given.page:
            write_page(found)
    except MocOptError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
