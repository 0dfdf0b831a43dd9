"""Bad input, in quantity: every case ends in success or in a MocOptError that says what is wrong.

python -m benchmarks.fuzz [--cases N] [--seed N] [--only KIND ...] [--resume] [--out DIR] [--json] [--page]

A long run keeps the figures of every kind that is through in DIR/kinds.json; ``--resume`` goes on behind them.
"""

from __future__ import annotations

import sys
import traceback
import warnings
from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.common import cli, output
from benchmarks.reliability.limits import limited
from benchmarks.reliability.page import COUNTS, PAGE, write_page
from moc_opt.embedded.compiler import CompilerError, find_compiler
from moc_opt.errors import ScenarioError
from moc_opt.inputs.files import read_json
from moc_opt.report.tables import Table

if TYPE_CHECKING:
    from benchmarks.reliability.fuzz_case import Kind

KINDS = {
    "scenario": 0.25, "scenario_file": 0.15, "robot_file": 0.15, "subproblem": 0.15, "result_file": 0.2,
    "record_file": 0.05, "exported": 0.05, "name": 0.1, "option": 0.05, "urdf_number": 0.1, "hostile_file": 0.2,
    "extreme_number": 0.2, "sweep_folder": 0.05, "study_folder": 0.05, "trace_folder": 0.05,
    "faulty_run": 0.02, "hostile_solver": 0.05, "foreign_trace": 0.1, "wire_packet": 0.1, "parquet_footer": 0.2,
}  # fmt: skip
"""Kind of input -> its share of the cases."""
BUSY_S, WALL_S = 20, 200
"""Seconds that a case may take: of the processor, and by the clock."""


def explore(kind: str, cases: int, seed: int, done: Callable[[], Any]) -> tuple[Counter[str], list[str]]:
    """Draw and check.

    Returns:
        how often each verdict was given, and the smallest input of every failure, with what happened.

    Raises:
        CompilerError: kind "exported" without a C compiler.
    """
    import hypothesis
    from hypothesis import HealthCheck

    from benchmarks.reliability import fuzz_c, fuzz_case, fuzz_checks

    check, strategy = lookup(kind)
    fuzz_checks.warm_up()
    if kind == "exported":
        fuzz_c.warm_up()
    done()
    verdicts: Counter[str] = Counter()
    failures: list[str] = []

    last: list[Any] = [None]

    def one(case: Any) -> None:
        last[0] = case
        try:
            with fuzz_case.time_limit(BUSY_S, WALL_S):
                verdicts[check(case)] += 1
        finally:
            done()

    quiet = hypothesis.settings(
        max_examples=max(1, min(cases, 500)), database=None, deadline=None, print_blob=False,
        suppress_health_check=list(HealthCheck), report_multiple_bugs=False, verbosity=hypothesis.Verbosity.quiet,
    )  # fmt: skip
    part = 0
    warnings.simplefilter("ignore", hypothesis.errors.HypothesisWarning)  # of long inputs
    while verdicts.total() < cases and len(failures) < 3:
        # in rounds: a long search settles on what it has seen
        attempt = hypothesis.seed(1000 * seed + part)(quiet(hypothesis.given(strategy)(one)))
        part += 1
        try:
            attempt()
        except (Exception, fuzz_case.Hang) as error:  # noqa: BLE001 - whatever comes out is the finding
            cause = error.exceptions[0] if isinstance(error, ExceptionGroup) else error
            where = traceback.extract_tb(cause.__traceback__)[-1]
            place = f"{Path(where.filename).name}:{where.lineno}"
            what = " ".join(f"{cause} ({place}); input: {last[0]!r}".split())
            failures.append(f"{type(cause).__name__}: {what:.900}")
    return verdicts, failures


def lookup(kind: str) -> Kind:
    """Find the check of one kind of input, and where its cases come from."""
    from benchmarks.reliability import (
        fuzz_checks,
        fuzz_file_checks,
        fuzz_names,
        fuzz_numbers,
        fuzz_pages,
        fuzz_runs,
        fuzz_solvers,
        fuzz_wire,
    )  # fmt: skip

    every = (
        fuzz_checks, fuzz_file_checks, fuzz_names, fuzz_numbers, fuzz_pages, fuzz_runs, fuzz_solvers, fuzz_wire,
    )  # fmt: skip
    return next(module.KINDS[kind] for module in every if kind in module.KINDS)


def has_compiler() -> bool:
    """Tell whether the kind "exported" can be checked here."""
    try:
        return bool(find_compiler())
    except CompilerError:
        return False


def through(kept: Path, asked: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Read the figures of the kinds that an interrupted run with the same cases was through with; {} of any other."""
    found = read_json(kept, "figures of the fuzzer", ScenarioError) if kept.exists() else {}
    return dict(found["kinds"]) if {name: found.get(name) for name in asked} == asked else {}


def send(given: Namespace) -> cli.Results:
    """Send the cases of every kind; status 1 where one did not end well."""
    kinds = given.only or list(KINDS)
    if not given.only and not has_compiler():
        print("exported: left out, as there is no C compiler here", file=sys.stderr)
        kinds.remove("exported")
    whole = sum(KINDS[kind] for kind in kinds)
    shares = {kind: max(1, round(given.cases * KINDS[kind] / whole)) for kind in kinds}
    environment = output.environment({"cases": given.cases, "kinds": kinds}, given.seed, given.argv)
    asked = {"seed": given.seed, "shares": shares, "commit": environment["commit"]}
    kept = given.out / "kinds.json"
    summary: dict[str, dict[str, Any]] = through(kept, asked) if given.resume else {}
    left = {kind: cases for kind, cases in shares.items() if kind not in summary}
    with cli.steps("cases", sum(left.values())) as step:
        for kind, cases in left.items():
            verdicts, failures = limited(explore, kind, cases, given.seed, step, WALL_S)
            summary[kind] = {
                "cases": verdicts.total() + len(failures), "accepted": verdicts["accepted"],
                "refused": verdicts["refused"], "failed": len(failures), "failures": failures,
            }  # fmt: skip
            output.write_json(kept, {**asked, "kinds": summary})
    if given.page:
        write_page({"fuzz": {"cases": given.cases, "seed": given.seed, "kinds": summary}})
    table = Table("Bad input", COUNTS, [{"kind": kind, **figures} for kind, figures in summary.items()])
    told = [f"{kind}: {failure}" for kind, figures in summary.items() for failure in figures["failures"]]
    return cli.Results(summary, environment, tables=[table], sentences=told, status=1 if told else 0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; see `cli.run` for the exit status."""
    options = cli.parser("fuzz", "Send bad input.", configured=False)
    options.add_argument("--cases", type=int, default=10_000, help="in all")
    options.add_argument("--seed", type=cli.seed_number, default=0)
    options.add_argument("--only", nargs="+", choices=list(KINDS), help="these kinds of input alone")
    options.add_argument("--resume", action="store_true", help="leave out the kinds that a run before was through with")
    options.add_argument("--page", action="store_true", help=f"put the figures into {PAGE.parent.name}/{PAGE.name}")
    return cli.run(options, send, arguments)


if __name__ == "__main__":
    sys.exit(main())
