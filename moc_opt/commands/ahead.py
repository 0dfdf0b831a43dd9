"""The command `plan`: what is known of a scenario before anything moves."""

from __future__ import annotations

import argparse
import sys
import time

from moc_opt.commands.running import read_scenario


def plan_scenario(given: argparse.Namespace) -> int:
    """Plan, print, and write the course."""
    from moc_opt.report.console import console, print_json
    from moc_opt.report.document import check_out
    from moc_opt.report.plan_table import place_json, place_table, plan_json, plan_tables
    from moc_opt.scenario.followable import following_warnings
    from moc_opt.scenario.placement import place
    from moc_opt.scenario.planned import plan, save_course

    scenario, title = read_scenario(given.scenario)
    if given.out is not None:
        check_out(given.out, "course")
    asked = {"objective": given.objective, "margin_rad": given.margin, "speed_share": given.speed_share}
    found = plan(scenario, acceleration=given.acceleration, **asked)
    began, places = time.perf_counter(), []
    if given.place is not None:
        places = place(scenario, given.place, box_m=given.box, candidates=given.candidates, **asked)
    took = time.perf_counter() - began
    warned = following_warnings(scenario, found)
    for line in warned:
        print(f"{title}: warning: {line}", file=sys.stderr)
    if given.json:
        searched = {"places": place_json(places), "place_s": took} if places else {}
        print_json(plan_json(found) | {"warnings": warned} | searched)
    else:
        screen = console()
        shown = plan_tables(title, found)
        if places:
            shown.append(place_table(f"Places of the {given.place}", given.candidates, given.box, took, places))
        for table in shown:
            for piece in table.fitted(screen.width):
                screen.print(piece)
    if given.out is not None:
        path = save_course(found, scenario, given.out)
        print(path, file=sys.stderr if given.json else sys.stdout)
    return 0 if found.executable else 3
