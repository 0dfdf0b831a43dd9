"""moc-opt replay, map and live: saved runs as pages, and a scenario on a page of this machine."""

from __future__ import annotations

import argparse


def save_replay(given: argparse.Namespace) -> int:
    """Write one to four saved runs in 3-D; returns 0."""
    from moc_opt.report.document import check_out
    from moc_opt.report.replay import Replay

    check_out(given.out, "replay", force=given.force)
    print(Replay.load(given.traces).save(given.out, force=given.force))
    return 0


def save_map(given: argparse.Namespace) -> int:
    """Write the page, then the figures: the page is there even where no browser can draw the files; returns 0."""
    from moc_opt.report.document import check_out
    from moc_opt.report.export import save_figures
    from moc_opt.report.map_page import load_map

    check_out(given.out, "map", force=given.force)
    page = load_map(given.traces)
    print(page.save(given.out, force=given.force))
    for file in save_figures(page.figures, given.out.parent / "figures") if given.figures else ():
        print(file)
    return 0


def serve_page(given: argparse.Namespace) -> int:
    """Run a scenario in real time until the page is left; returns the exit status."""
    from moc_opt.live.page import serve
    from moc_opt.scenario import Scenario

    scenario = Scenario() if given.scenario is None else Scenario.load(given.scenario)
    named = "name" in scenario.model_fields_set
    title = scenario.name if named else scenario.task.path if given.scenario is None else given.scenario.stem
    return serve(scenario, port=given.port, title=title)
