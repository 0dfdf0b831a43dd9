"""The command `plan`: plan a scenario before its run."""

from __future__ import annotations

import argparse
import sys
import time

from moc_opt.commands.running import read_scenario
from moc_opt.errors import MocOptError, ScenarioError

OPTIONS = {
    "margin_rad = ": "--margin ", "margin_rad and margin_m": "--margin and --margin-m",
    "speed_share = ": "--speed-share ", "acceleration = ": "--acceleration ",
    "box_m = ": "--box ", "candidates = ": "--candidates ",
}  # fmt: skip
"""An argument as errors begin with it -> the option that gave it."""


def plan_scenario(given: argparse.Namespace) -> int:
    """Plan, print, and write the course.

    Raises:
        MocOptError: the scenario is not usable, an option is out of range, or the course cannot be written.
    """
    try:
        return _plan_scenario(given)
    except MocOptError as error:
        for argument, option in OPTIONS.items():
            if str(error).startswith(argument):
                error.args = (str(error).replace(argument, option, 1),)
        raise


def _plan_scenario(given: argparse.Namespace) -> int:
    from moc_opt.report.console import console, print_json
    from moc_opt.report.document import check_out
    from moc_opt.report.plan_table import place_json, place_table, plan_json, plan_tables, start_toml
    from moc_opt.scenario.placement import place
    from moc_opt.scenario.planned import followable_plan, following_warnings, save_course
    from moc_opt.trace.file import new_file

    for option, value in (("--box", given.box), ("--candidates", given.candidates)):
        if value is not None and given.place is None:
            raise ScenarioError(f"{option} {value}: without --place nothing is searched; add --place trocar or base")
    box_m = 0.05 if given.box is None else float(given.box)
    candidates = 40 if given.candidates is None else int(given.candidates)
    scenario, title = read_scenario(given.scenario)
    if given.out is not None:
        new_file(given.out)  # before the search, which may take a minute
        check_out(given.out, "course", force=given.force)
    follows = scenario.control.follows or given.out is not None  # a course is written to be followed
    found, within = followable_plan(
        scenario, given.margin, given.speed_share, objective=given.objective, acceleration=given.acceleration,
        margin_m=given.margin_m, followed=follows,
    )
    began, places = time.perf_counter(), []
    if given.place is not None:
        places = place(scenario, given.place, box_m=box_m, candidates=candidates, objective=given.objective, **within)
    took = time.perf_counter() - began
    warned = following_warnings(scenario, found) if follows else []
    if given.json:
        told = {"places": place_json(places), "place_s": took} if places else {}
        print_json(plan_json(found) | {"within": within, "warnings": warned} | told)
    else:
        screen = console()
        shown = plan_tables(title, found, **within)
        if places:
            shown.append(place_table(f"Places of the {given.place}", candidates, box_m, took, places))
        for table in shown:
            screen.print(table)
        print(start_toml(scenario.robot.arm(), found, places))
    for line in warned:  # last, below the tables
        print(f"{title}: warning: {line}", file=sys.stderr)
    if given.out is not None and found.course is None:
        print(f"{title}: --out {given.out}: no course goes all the way: nothing is written", file=sys.stderr)
    elif given.out is not None:
        limits = {**within, "acceleration": given.acceleration}
        path = save_course(found, scenario, given.out, limits)
        print(path, file=sys.stderr if given.json else sys.stdout)
    return 0 if found.executable else 3
