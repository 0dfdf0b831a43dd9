"""moc-opt report: saved runs as one page."""

from __future__ import annotations

import argparse


def report_runs(given: argparse.Namespace) -> int:
    """Write the page, and print its name; returns 0.

    Raises:
        MocOptError: a file is no trace, they are not of one arm, or the page cannot be written.
    """
    from moc_opt.report.document import check_out
    from moc_opt.report.replay import load_runs
    from moc_opt.report.run_page import run_page
    from moc_opt.trace.metrics import summarize

    check_out(given.out, "report", force=given.force)
    traces, robot = load_runs(given.traces)
    metrics = {name: summarize(trace) for name, trace in traces.items()}
    print(run_page(traces, metrics, robot).save(given.out, force=given.force))
    return 0
