"""The main job: every solver on certified and recorded subproblems, and in the same torque controller.

python -m benchmarks.solvers [CONFIG.toml] [--out DIR] [--seed N] [--quick | --full] [--only SOLVER ...]
                             [--sets NAME ...] [--parts PART ...]

A run that was stopped goes on where it stopped: finished parts are kept in DIR/parts, and a part whose question, data,
libraries or source changed is done again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from benchmarks import cli, export, output
from benchmarks.solver_study.config import PARTS, Config
from benchmarks.solver_study.look import look
from benchmarks.solver_study.parts import Study
from benchmarks.solver_study.report import print_tables, write_report
from benchmarks.timing import clock_cost_us, each_us
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.report.console import console, progress
from moc_opt.solvers import available


def choose(wanted: Literal["all"] | list[str]) -> tuple[list[str], dict[str, str]]:
    """Names that can run here, and name -> reason for those that cannot.

    Raises:
        UnknownNameError: a name that no solver has.
    """
    found = available()
    names = list(found) if wanted == "all" else wanted
    for name in names:
        if name not in found:
            raise UnknownNameError("solver", name, found)
    reasons = {name: reason for name in names if (reason := found[name]) is not None}
    return [name for name in names if name not in reasons], reasons


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the comparison; 0, or 2 with a message where the input is wrong."""
    options = cli.parser("solvers", "Compare the solvers, open loop and in closed loop.")
    options.add_argument("--full", action="store_true", help="more of everything; takes an hour or two")
    options.add_argument("--only", nargs="+", metavar="SOLVER", help="these solvers alone")
    options.add_argument("--sets", nargs="+", metavar="NAME", help="these test sets alone")
    options.add_argument("--parts", nargs="+", metavar="PART", choices=PARTS, help=f"of {', '.join(PARTS)}")
    given = options.parse_args(arguments)
    try:
        config = Config.chosen(given, "solvers")
        if given.full and not given.quick:
            config = config.full()
        config = config.choosing(given.sets, given.parts)
        names, missing = choose(given.only or config.solvers)
        compare(config, names, missing, given.out, given.json, list(arguments or sys.argv[1:]), given.figures)
    except MocOptError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"stopped; the same command goes on from {given.out}/parts", file=sys.stderr)
        return 130
    return 0


def assembly_us(problems: Sequence[NullSpaceQP]) -> float:
    """Median time [us] of assembling P, p and the five rows, which every session does once a tick in a loop."""
    fresh = [NullSpaceQP.from_row(qp.row.copy()) for qp in problems]
    assembled(fresh[0])
    times = each_us(assembled, fresh)
    return float(sorted(times)[len(times) // 2])


def compare(
    config: Config, names: list[str], missing: dict[str, str], out: Path, as_json: bool, argv: list[str],
    figures: bool = False,
) -> dict[str, Any]:
    """All parts, all files; returns the summary."""
    with progress("solvers") as bar:

        def advance(text: str) -> None:
            bar.at(text)
            bar.advance()

        study = Study(config, names, out, advance)
        bar.of(study.steps)
        study.run()
        if "qpbenchmark" in config.parts:
            study.summary["qpbenchmark"] = export.ranking(out / "qpbenchmark", names)
            advance("qpbenchmark")
    summary = study.summary
    summary["not_run"] = {
        **{name: {"reason": reason} for name, reason in missing.items()},
        **summary["not_run"],
    }
    summary["clock"] = {
        "cost": {"p50_us": clock_cost_us()},
        "assembly": {"p50_us": assembly_us(study.sequence)},
    }

    seen = look(config.scenario.change(duration_s=config.closed_loop.duration_s), study.runs)
    if seen is not None:
        summary["courses"] = seen.rows()
    environment = output.environment(config.model_dump(mode="json"), config.seed, argv)
    environment["parts_of_an_earlier_run"] = study.store.reused
    environment["seconds"] = study.seconds
    output.write_json(
        out / "summary.json", {**summary, "words": {k: {"text": v} for k, v in study.words.items()}}
    )
    output.write_rows(out / "rows.parquet", study.rows + [run.row() for run in study.runs])
    output.write_json(out / "environment.json", environment)
    write_report(out / "report.html", study, environment, seen, figures)
    if as_json:
        print((out / "summary.json").read_text(), end="")
    else:
        print_tables(console(), study, out)
    return summary


if __name__ == "__main__":
    sys.exit(main())
