"""moc-opt compare, and moc-opt solvers: solvers on the same trials, and the whole study of them."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from moc_opt.commands.listing import print_list
from moc_opt.commands.running import read_scenario
from moc_opt.report.console import console, print_json, progress
from moc_opt.report.document import check_out
from moc_opt.study import solvers
from moc_opt.study.compare import compare
from moc_opt.study.statistics import Change, too_few


def compare_solvers(given: argparse.Namespace) -> int:
    """Compare, print, and write the rows; returns 0, 3 where a solver drove no trial to its end, 130 after Ctrl-C."""
    if given.out is not None:
        check_out(given.out, "table of runs", force=given.force)
    scenario, _ = read_scenario(given.scenario)
    with progress("compare", given.trials * (len(given.solvers) + 1)) as bar:

        def watch(words: str) -> None:
            bar.at(words)
            bar.advance()

        found = compare(given.solvers, scenario, given.trials, seed=given.seed, watch=watch)
    if given.json:
        print_json({name: {key: _plain(value) for key, value in of.items()} for name, of in found.summary().items()})
    else:
        console().print(found.table)
    if given.out is not None:
        found.save_rows(given.out)
    lost = [name for name in found.solvers if not found.values(name, "mu_mean")]
    for name in lost:
        reason = next(row["error"] for row in found.rows if row["solver"] == name)
        print(f"{name}: no trial came to its end; the first: {reason}", file=sys.stderr)
    if not found.complete:
        return 130  # as after any Ctrl-C
    return 3 if lost else 0


def list_or_study(given: argparse.Namespace) -> int:
    """List the solvers, or run the whole study of them with its own arguments; returns its exit status."""
    if given.list:
        return print_list(given)
    return solvers.main([*given.rest, *(["--json"] if given.json else [])])


def _plain(value: Any) -> Any:
    if not hasattr(value, "_asdict"):
        return value
    found = {key: _plain(entry) for key, entry in value._asdict().items()}
    if isinstance(value, Change):
        found |= {"undecided": value.undecided, "too_few": too_few(value.ratio.samples)}
    return found
