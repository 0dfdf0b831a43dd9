"""What each defect of the arm costs, alone and together: calibration error, encoder bias, elastic joints, ripple.

python -m benchmarks.plant [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json] [--page]

Every trial is run under DCAC and MOC with the same gains, in the plant without these defects and with each of them;
--page also writes the table into docs/plant.md.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence

from benchmarks.common import cli
from benchmarks.common.crew import run_parallel
from benchmarks.common.kept import Kept
from benchmarks.common.markdown import write_section
from benchmarks.plant_study.runs import Config, run_job
from benchmarks.plant_study.tables import PAGE, page_text, summarise, tables


def study(given: Namespace) -> cli.Results:
    """Run every job; with ``--page`` write the tables into docs/plant.md."""
    config = Config.chosen(given, "plant")
    jobs = config.jobs()
    kept = Kept(given.out / "jobs", config.model_dump(mode="json"))
    with cli.steps("plants", len(jobs)) as step:
        parts = run_parallel(run_job, jobs, config.processes, step, kept)
    rows = [row for part in parts for row in part]
    summary = summarise(config, rows)
    if given.page:
        write_section(PAGE, "plant", page_text(summary, config))
    environment = config.environment(given, jobs_of_an_earlier_run=kept.reused)
    return cli.Results(summary, environment, rows, tables=tables(summary))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("plant", "What each defect of the arm costs.")
    options.add_argument("--page", action="store_true", help=f"write the table into {PAGE.parent.name}/{PAGE.name}")
    return cli.run(options, study, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
