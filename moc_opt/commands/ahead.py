"""The command `plan`: what is known of a scenario before anything moves."""

from __future__ import annotations

import argparse
import sys
import textwrap
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.commands.running import read_scenario
from moc_opt.errors import MocOptError, ScenarioError

if TYPE_CHECKING:
    from moc_opt.planning.placement import Placement
    from moc_opt.planning.plan import Plan
    from moc_opt.scenario import Scenario

OPTIONS = {
    "margin_rad = ": "--margin ", "speed_share = ": "--speed-share ", "acceleration = ": "--acceleration ",
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
    from moc_opt.report.plan_table import place_json, place_table, plan_json, plan_tables
    from moc_opt.scenario.followable import following_warnings
    from moc_opt.scenario.placement import place
    from moc_opt.scenario.planned import save_course

    for option, value in (("--box", given.box), ("--candidates", given.candidates)):
        if value is not None and given.place is None:
            raise ScenarioError(f"{option} {value}: without --place nothing is searched; add --place trocar or base")
    box_m = 0.05 if given.box is None else float(given.box)
    candidates = 40 if given.candidates is None else int(given.candidates)
    scenario, title = read_scenario(given.scenario)
    if given.out is not None:
        check_out(given.out, "course")
    found, asked = _planned(scenario, given)
    began, places = time.perf_counter(), []
    if given.place is not None:
        places = place(scenario, given.place, box_m=box_m, candidates=candidates, **asked)
    took = time.perf_counter() - began
    follows = scenario.control.third_level != "local" or given.out is not None
    warned = following_warnings(scenario, found) if follows else []
    for line in warned:
        print(f"{title}: warning: {line}", file=sys.stderr)
    if given.json:
        told = {"places": place_json(places), "place_s": took} if places else {}
        within = {"margin": asked["margin_rad"], "speed_share": asked["speed_share"]}
        print_json(plan_json(found) | {"within": within, "warnings": warned} | told)
    else:
        screen = console()
        shown = plan_tables(title, found, asked["margin_rad"], asked["speed_share"])
        if places:
            shown.append(place_table(f"Places of the {given.place}", candidates, box_m, took, places))
        for table in shown:
            for piece in table.fitted(screen.width):
                screen.print(piece)
        print(start_toml(scenario, found, places))
    if given.out is not None:
        path = save_course(found, scenario, given.out)
        print(path, file=sys.stderr if given.json else sys.stdout)
    return 0 if found.executable else 3


def start_toml(scenario: Scenario, plan: Plan, places: Sequence[Placement] = ()) -> str:
    """Write the tables that begin a scenario where the best course, or that of the best place, does; empty without one.

    A number is rounded towards the inside of its joint's limits.
    """
    course, depth, of = plan.best, None, "the best course"
    if places and places[0].course is not None:
        course, depth, of = places[0].course, places[0].depth_m, "the course of the first place"
    if course is None:
        return ""
    robot = scenario.robot.arm()
    inside = np.ceil(1e6 * robot.q_min) / 1e6, np.floor(1e6 * robot.q_max) / 1e6
    q = np.clip(np.round(course.q_rad[0], 6), *inside)
    numbers = textwrap.fill(", ".join(f"{x:.6f}" for x in q), 76, initial_indent="  ", subsequent_indent="  ")
    trocar = [] if depth is None else ["[trocar]", f"depth_m = {depth:.6f}"]
    about = f"# begins {of}; in place of the scenario's own [start]{' and depth_m' if trocar else ''}:"
    return "\n".join([about, "[start]", f"q_rad = [\n{numbers},\n]", *trocar])


def _planned(scenario: Scenario, given: argparse.Namespace) -> tuple[Plan, dict[str, Any]]:
    """The plan, and within what it was made: where an option is left out, what a third level that follows keeps to."""
    from moc_opt.scenario.guided import followed_share
    from moc_opt.scenario.planned import plan

    settings = scenario.control
    follows = settings.third_level != "local"
    margins = dict.fromkeys((settings.limit_margin_rad, 0.0) if follows else (0.0,))  # as `guided` tries them
    share = followed_share(settings) if follows else 1.0
    for margin in margins if given.margin is None else (given.margin,):
        asked: dict[str, Any] = {
            "objective": given.objective, "margin_rad": margin,
            "speed_share": share if given.speed_share is None else given.speed_share,
        }  # fmt: skip
        found = plan(scenario, acceleration=given.acceleration, **asked)
        if found.executable:
            break
    return found, asked
