"""The main job: every solver on certified and recorded subproblems, and in the same torque controller.

python -m benchmarks.solvers [CONFIG.toml] [--out DIR] [--seed N] [--quick | --full] [--only SOLVER ...]
                             [--sets NAME ...] [--parts PART ...]

Four to five minutes on two cores; benchmarks/configs/solvers-long.toml asks for more and takes fifteen, --full
for more yet. A run that was stopped goes on where it stopped: finished jobs are kept in DIR/jobs, and a job whose
question, data, libraries or source changed is done again.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Any

from benchmarks.common import cli, output
from benchmarks.common.config import choose
from benchmarks.solver_study.closed_parts import JOBS, SECONDS, STAGES
from benchmarks.solver_study.config import PARTS, Config
from benchmarks.solver_study.first_screen import answer, timed_rows
from benchmarks.solver_study.look import look
from benchmarks.solver_study.progress import Progress
from benchmarks.solver_study.report import report_page, sentences
from benchmarks.solver_study.settings import QPSOLVERS
from benchmarks.solver_study.study import Study, run_study
from benchmarks.solver_study.tables import tables
from benchmarks.subproblems import qpbenchmark
from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.report.console import console, progress
from moc_opt.study.timing import Disturbance, clock_cost_us, each_us


def once(names: list[str]) -> tuple[list[str], dict[str, str]]:
    """Return the names without a library that is there through an adapter of its own, and name -> reason for those."""
    native = {f"{QPSOLVERS}{name}": name for name in names}
    return [name for name in names if name not in native], {
        name: f"the same library as `{native[name]}`: `twice = true` in the configuration asks both ways"
        for name in names if name in native
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; returns the exit status."""
    options = cli.parser("solvers", "Compare the solvers, open loop and in closed loop.")
    options.epilog = "`moc-opt solvers --list` prints the solvers that can run here, and their settings."
    options.add_argument("--full", action="store_true", help="more of everything; takes an hour or two")
    options.add_argument("--only", nargs="+", metavar="SOLVER", help="these solvers alone")
    options.add_argument("--sets", nargs="+", metavar="NAME", help="these test sets alone")
    options.add_argument("--parts", nargs="+", metavar="PART", choices=PARTS, help=f"of {', '.join(PARTS)}")
    return cli.run(options, compare, arguments, cli.GOES_ON)


def assembly_us(problems: Sequence[NullSpaceQP]) -> float:
    """Measure the median time [us] of assembling P, p and the five rows, as every session does once a tick."""
    fresh = [NullSpaceQP.from_row(qp.row.copy()) for qp in problems]
    assembled(fresh[0])
    times = each_us(assembled, fresh)
    return float(sorted(times)[len(times) // 2])


def compare(given: Namespace) -> cli.Results:
    """Run all parts, and put together what is written and printed."""
    config = Config.chosen(given, "solvers")
    if given.full and not given.quick:
        config = config.full()
    config = config.choosing(given.sets, given.parts)
    names, missing = choose(given.only or config.solvers)
    libraries = names
    if not (config.twice or given.only):
        names, again = once(names)
        missing |= again
    weighed: dict[str, float] = {part: SECONDS[part] / STAGES.get(part, 1) for part in config.parts}
    shown = Progress(weighed, console(stderr=True), config.scenario.deadline_us)
    study = Study(config, names, given.out, shown.advance, shown.show, shown.enter)
    total = sum(SECONDS[part] for part in weighed)
    try:
        with progress("solvers", total, below=shown.below) as shown.bar:
            found = run_study(study, JOBS)
            if "qpbenchmark" in config.parts:
                shown.enter("qpbenchmark")
                found.summary["qpbenchmark"] = qpbenchmark.ranking(given.out / "qpbenchmark", libraries)
                shown.advance("qpbenchmark")
    except KeyboardInterrupt:
        shown.interrupted(console())
        raise
    summary: dict[str, Any] = found.summary
    summary["not_run"] = {name: {"reason": reason} for name, reason in missing.items()} | summary["not_run"]
    summary["clock"] = {
        "cost": {"p50_us": clock_cost_us()},
        "assembly": {"p50_us": assembly_us(found.sequence)},
    }
    seen = look(config.scenario.change(duration_s=config.closed_loop.duration_s), found.runs)
    if seen is not None:
        summary["courses"] = seen.rows()
    environment = output.environment(config.model_dump(mode="json"), config.seed, given.argv)
    environment |= {"jobs_of_an_earlier_run": study.kept.reused, "seconds": found.seconds}
    environment |= {"load": Disturbance.total(timed_rows(summary)).told()}
    first = answer(summary, config.scenario.deadline_us)
    return cli.Results(
        {**summary, "words": {name: {"text": text} for name, text in found.words.items()}},
        environment,
        rows=found.rows + [run.row() for run in found.runs],
        page=report_page(study, found, tables(summary), environment, seen, first),
        answer=first,
        sentences=sentences(study, found),
        files=["replay.html"] if seen is not None else [],
    )


if __name__ == "__main__":
    sys.exit(main())
