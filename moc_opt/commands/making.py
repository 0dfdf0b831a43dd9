"""Commands that write pages, C code and comparisons."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from itertools import chain

from moc_opt.commands.listing import print_list
from moc_opt.commands.running import read_scenario
from moc_opt.report.console import Bar, console, print_json
from moc_opt.report.document import check_out
from moc_opt.trace.meta import Ending


def save_page(given: argparse.Namespace) -> int:
    """Write a page from saved runs."""
    from moc_opt.report.export import save_figures
    from moc_opt.report.map_page import load_map
    from moc_opt.report.page import Page
    from moc_opt.report.replay import Replay, load_runs
    from moc_opt.report.run_page import load_report

    check_out(given.out, given.command, force=given.force)
    makers: dict[str, Callable[..., Page]] = {"map": load_map, "report": load_report}
    page = Replay(*load_runs(given.traces)) if given.command == "replay" else makers[given.command](given.traces)
    print(page.save(given.out, force=given.force))
    if isinstance(page, Page) and getattr(given, "figures", False):  # an option of `map`
        print(*save_figures(page.figures, given.out.parent / "figures"), sep="\n")
    return 0


def serve_page(given: argparse.Namespace) -> int:
    """Run a scenario on a local web page."""
    from moc_opt.live.page import serve

    scenario, title = read_scenario(given.scenario)
    return serve(scenario, port=given.port, title=title)


def export_c(given: argparse.Namespace) -> int:
    """Write controller and safety filter as C code."""
    from moc_opt.export import export_scenario

    out, udp = given.out, given.main == "udp"
    for file in export_scenario(read_scenario(given.scenario)[0], out, udp=udp, force=given.force):
        print(file)
    print(f"next: make -C {out} test")
    if udp:
        print(f"then: make -C {out} moc_udp && {out}/moc_udp 127.0.0.1 30200 {out}/reference.bin")
    return 0


def compare_solvers(given: argparse.Namespace) -> int:
    """Compare solvers; return 3 if a solver completed no trial."""
    from moc_opt.study.compare import compare

    if given.out is not None:
        check_out(given.out, "table of runs", force=given.force)
    scenario, _ = read_scenario(given.scenario)
    with Bar("compare", given.trials * (len(given.solvers) + 1)) as bar:
        found = compare(given.solvers, scenario, given.trials, seed=given.seed, watch=bar.step)
    if given.json:
        print_json(found.summary())
        for sentence in chain.from_iterable(found.failures.values()):
            print(sentence, file=sys.stderr)
    else:
        console().print(found.table)
    if given.out is not None:
        found.save_rows(given.out)
        print(given.out, file=sys.stderr if given.json else sys.stdout)
    completed = {row["solver"] for row in found.rows if Ending.of(row["ended"]).whole}
    lost = [name for name in found.solvers if name not in completed]
    for name in lost:
        reason = next(row["error"] for row in found.rows if row["solver"] == name)
        print(f"{name}: no trial was completed; the first trial: {reason}", file=sys.stderr)
    if not found.complete:
        return 130
    return 3 if lost else 0


def list_or_study(given: argparse.Namespace) -> int:
    """List the solvers, or run the solver study."""
    if given.list:
        return print_list(given)
    from moc_opt.study import solvers

    return solvers.main([*given.rest, *(["--json"] if given.json else [])])
