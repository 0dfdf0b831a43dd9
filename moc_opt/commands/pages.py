"""What a command makes of saved runs or of a scenario: pages, the live page, a folder of C."""

from __future__ import annotations

import argparse

from moc_opt.commands.running import read_scenario
from moc_opt.report.document import check_out


def save_replay(given: argparse.Namespace) -> int:
    """Write one to four saved runs in 3-D; returns 0."""
    from moc_opt.report.replay import Replay

    check_out(given.out, "replay", force=given.force)
    print(Replay.load(given.traces).save(given.out, force=given.force))
    return 0


def save_map(given: argparse.Namespace) -> int:
    """Write the page, then the figures: the page is there even where no browser can draw the files; returns 0."""
    from moc_opt.report.export import save_figures
    from moc_opt.report.map_page import load_map

    check_out(given.out, "map", force=given.force)
    page = load_map(given.traces)
    print(page.save(given.out, force=given.force))
    for file in save_figures(page.figures, given.out.parent / "figures") if given.figures else ():
        print(file)
    return 0


def save_report(given: argparse.Namespace) -> int:
    """Write metrics, curves and map of saved runs; returns 0."""
    from moc_opt.report.replay import load_runs
    from moc_opt.report.run_page import run_page
    from moc_opt.trace.metrics import summarize

    check_out(given.out, "report", force=given.force)
    traces, robot = load_runs(given.traces)
    metrics = {name: summarize(trace) for name, trace in traces.items()}
    print(run_page(traces, metrics, robot).save(given.out, force=given.force))
    return 0


def serve_page(given: argparse.Namespace) -> int:
    """Run a scenario in real time until the page is left; returns the exit status."""
    from moc_opt.live.page import serve

    scenario, title = read_scenario(given.scenario)
    return serve(scenario, port=given.port, title=title)


def export_c(given: argparse.Namespace) -> int:
    """Write the whole controller as C, with recorded ticks for its self-test; returns 0."""
    from moc_opt.export import export_scenario

    out, udp = given.out, given.main == "udp"
    for file in export_scenario(read_scenario(given.scenario)[0], out, udp=udp, force=given.force):
        print(file)
    print(f"next: make -C {out} test")
    if udp:
        print(f"then: make -C {out} moc_udp, {out}/moc_udp 127.0.0.1 30200 {out}/reference.bin")
    return 0
