"""Every fault under every controller: survived, or stopped safely?

python -m benchmarks.faults [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--page]

--page also writes docs/reliability.md, and docs/reliability.json with the figures in it.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence

from benchmarks.common import cli
from benchmarks.common.config import runnable
from benchmarks.common.crew import run_parallel
from benchmarks.reliability.config import Config
from benchmarks.reliability.page import PAGE, write_page
from benchmarks.reliability.report import answer, report
from benchmarks.reliability.runs import jobs, run_job
from benchmarks.reliability.summary import goals, summarise


def inject(given: Namespace) -> cli.Results:
    """Inject every fault; with ``--page`` write docs/reliability.md."""
    config = Config.chosen(given, "faults")
    runnable(config.solvers)
    work = jobs(config)
    with cli.steps("faults", len(work)) as step:
        outcomes = run_parallel(run_job, work, config.processes, step)
    rows = [row for outcome in outcomes for row in outcome.rows]
    traces = {name: trace for outcome in outcomes for name, trace in outcome.traces.items()}
    cases = summarise(rows)
    reached = goals(config, cases)
    shared = config.processes > 1
    timing = f"shared: {config.processes} processes at a time" if shared else "one process"
    environment = config.environment(given, timing=timing)
    if given.page:
        write_page({"cases": cases, "goals": reached, "environment": environment})
    first = answer(cases, reached, traces)
    return cli.Results(
        {**cases, "goals": {goal["goal"]: goal for goal in reached}}, environment, rows,
        report(cases, reached, first, environment), answer=first,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("faults", "Inject every fault under every controller.")
    options.add_argument("--page", action="store_true", help=f"write {PAGE.parent.name}/{PAGE.name} as well")
    return cli.run(options, inject, arguments)


if __name__ == "__main__":
    sys.exit(main())
