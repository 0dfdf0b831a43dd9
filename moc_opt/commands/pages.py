"""What a command makes of saved runs or of a scenario: pages, the live page, a folder of C."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from moc_opt.commands.running import read_scenario
from moc_opt.report.document import check_out


def save_page(given: argparse.Namespace) -> int:
    """Write saved runs as the page that the command is called after, then its figures if asked for; returns 0.

    The page is there even where no browser can draw the figures.
    """
    from moc_opt.report.export import save_figures
    from moc_opt.report.map_page import load_map
    from moc_opt.report.page import Page
    from moc_opt.report.replay import Replay
    from moc_opt.report.run_page import load_report

    check_out(given.out, given.command, force=given.force)
    makers: dict[str, Callable[..., Page | Replay]] = {"replay": Replay.load, "map": load_map, "report": load_report}
    page = makers[given.command](given.traces)
    print(page.save(given.out, force=given.force))
    if not isinstance(page, Replay) and getattr(given, "figures", False):  # an option of `map`
        print(*save_figures(page.figures, given.out.parent / "figures"), sep="\n")
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
