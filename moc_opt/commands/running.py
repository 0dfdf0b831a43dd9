"""The commands `run` and `plan`: one scenario, its metrics beside DCAC's with the same gains; its plan before a run."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from moc_opt.commands.parser import check_paths
from moc_opt.errors import MocOptError, ScenarioError, UnknownNameError, shown

if TYPE_CHECKING:
    from moc_opt.report.tables import Table
    from moc_opt.scenario import Scenario
    from moc_opt.trace.trace import Trace

HEADINGS = (["x_m", "y_m", "z_m"], ["x", "y", "z"])
"""Names of the columns of a file of waypoints that are read as such, in this order and in metres."""
PLAN_OPTIONS = {
    "margin_rad = ": "--margin ", "margin_rad and margin_m": "--margin and --margin-m",
    "speed_share = ": "--speed-share ", "acceleration = ": "--acceleration ",
    "box_m = ": "--box ", "candidates = ": "--candidates ",
}  # fmt: skip
"""An argument as errors begin with it -> the option that gave it."""


def read_scenario(path: Path | None) -> tuple[Scenario, str]:
    """Return the scenario of a file, or the default one, and its name in messages."""
    from moc_opt.scenario import Scenario

    scenario = Scenario() if path is None else Scenario.load(path)
    return scenario, scenario.name if path is None or "name" in scenario.model_fields_set else path.stem


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables as the screen has room for them."""
    from moc_opt.report.console import console

    screen = console()
    for table in tables:
        screen.print(table)


# --- run ---


def run_scenario(given: argparse.Namespace) -> int:
    """Run, summarise against DCAC with the same gains, print, save."""
    from moc_opt.report.console import progress
    from moc_opt.report.document import check_out
    from moc_opt.scenario import RunAway, Setup

    scenario, title = read_scenario(given.scenario)
    if "best_courses" not in scenario.model_fields_set:
        scenario = scenario.change(best_courses=True)
    scenario = changed(scenario, given)
    given.course = scenario.control.course or None  # the scenario's own file is not to be overwritten, either
    check_paths(given)
    if given.report is not None:
        check_out(given.report, "report", force=given.force)
    with progress(title) as bar:
        bar.at("sets up")
        setup = Setup(scenario)
        bar.of(len(setup.times()))

        def watch(tick: int) -> None:
            if tick and tick % 100 == 0:
                bar.at("")
                bar.advance(100)

        try:
            trace = setup.trace(watch, given.trace)
        except RunAway as error:
            trace = error.trace
    return show(scenario, title, trace, given)


def show(scenario: Scenario, title: str, trace: Trace, given: argparse.Namespace) -> int:
    """Print how a run ended, and its metrics; return the exit status."""
    from moc_opt.report.console import busy, console, print_json
    from moc_opt.report.run_page import run_page
    from moc_opt.report.run_table import MATTER, below_best, part, refusals, run_json, run_table, warnings
    from moc_opt.trace.metrics import summarize

    ended = str(trace.meta["ended"])
    for line in ([] if ended == "completed" else [f"{ended}{part(trace)}"]) + refusals(trace) + warnings(trace):
        print(f"{title}: {line}", file=sys.stderr)
    if below_best(trace):
        print(f"{title}: {below_best(trace)}", file=sys.stderr)
    try:
        baseline = _matched_dcac(scenario, title, len(trace)) if scenario.control.law == "moc" else None
    except KeyboardInterrupt as stop:
        if given.trace is not None:
            stop.add_note(f"the whole run is in {given.trace}")
        raise
    metrics = summarize(trace, baseline)
    if getattr(given, "report", None) is not None:  # `plant` has none
        runs = {title: trace} if baseline is None else {"DCAC, same gains": baseline, title: trace}
        page = run_page(runs, {title: metrics}, scenario.robot.arm())
        print(page.save(given.report, force=given.force), file=sys.stderr)
    for name in scenario.metrics:
        if name not in metrics:
            print(f"{title}: metric {name}: not known of this run", file=sys.stderr)
    wanted = {name: metrics[name] for name in scenario.metrics if name in metrics} if scenario.metrics else metrics
    if given.json:
        print_json(run_json(trace, wanted))
    else:
        short = not scenario.metrics and not given.all
        print_tables([run_table(title, trace, wanted, first=short)])
        if short:
            hidden = len(set(metrics) - set(MATTER))
            console().print(f"{hidden} more with `--all`; `moc-opt metrics` says what each is.", markup=False)
        if busy():
            console().print(busy(), soft_wrap=True)
    return 0 if ended == "completed" else 3


def changed(scenario: Scenario, given: argparse.Namespace) -> Scenario:
    """Return the scenario with the options of ``run`` in place of its own values."""
    from moc_opt.trace.metrics import METRICS, load_plugins

    if given.seed is not None:
        scenario = scenario.change(seed=given.seed)
    if given.robot is not None:
        scenario = scenario.change(robot={"name": given.robot})
    if given.third_level is not None:
        course = scenario.control.course if given.third_level == "planned" else ""
        scenario = scenario.change(control={"third_level": given.third_level, "course": course})
    if given.course is not None:
        if not given.course:
            raise ScenarioError("--course '': give the file that `moc-opt plan --out` wrote")
        if given.third_level not in (None, "planned"):
            raise ScenarioError(f"--course {given.course}: only --third-level planned follows a file; leave one out")
        scenario = scenario.change(control={"third_level": "planned", "course": given.course})
    if given.solver is not None:
        scenario = scenario.change(solver={"name": given.solver, "settings": {}})
    if given.task is not None:
        task: dict[str, object] = {"path": given.task, "sizes": {}, "waypoints_m": None}
        if Path(given.task).suffix.lower() in (".csv", ".txt"):
            task |= {"path": "waypoints", "waypoints_m": read_waypoints(given.task)}
        scenario = scenario.change(task=task)
    if given.metric:
        scenario = scenario.change(metrics=tuple(given.metric))
    load_plugins()
    for name in scenario.metrics:
        if name not in METRICS:
            raise UnknownNameError("metric", name, METRICS, "moc-opt metrics")
    return scenario


def read_waypoints(path: str) -> list[tuple[float, ...]]:
    """Read points x, y, z [m], one a line, split by commas or spaces.

    Lines that begin with # are left out, and the first other line may name the columns: x_m,y_m,z_m or x,y,z.

    Raises:
        ScenarioError: a line is no point, named with file and number, or there is none.
    """
    from moc_opt.inputs.files import decimal, read_text

    points: list[tuple[float, ...]] = []
    named = False
    for number, line in enumerate(read_text(path, "waypoints", ScenarioError).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        parts = line.replace(",", " ").split()
        if not points and not named and [part.strip("\"'").lower() for part in parts] in HEADINGS:
            named = True
            continue
        point = tuple(map(decimal, parts))
        if len(point) != 3 or not all(map(math.isfinite, point)):
            cure = "give x, y, z [m]; the first line may name the columns, x_m,y_m,z_m, and any other begins with #"
            if len(point) == 4 and point[0] == len(points):
                cure = "four columns, the first one counts: give x, y, z [m] alone (in pandas: to_csv(index=False))"
            raise ScenarioError(f"waypoints {path!r}, line {number}: {shown(line.strip(), 60)}: {cure}")
        points.append(point)
    if not points:
        raise ScenarioError(f"waypoints {path!r}: there is no point in it: give x, y, z [m], one point a line")
    return points


def _matched_dcac(scenario: Scenario, title: str, ticks: int) -> Trace | None:
    """Return the first ticks of DCAC with the same gains; None, and a word on it, where it was stopped before."""
    from moc_opt.scenario import RunAway, run

    try:
        matched = scenario.control.matched_dcac()
        trace = run(scenario.change(control=matched, bound_samples=0, best_courses=False))
    except RunAway as error:
        trace = error.trace
    if len(trace) < ticks or "mu" not in trace.columns:
        print(f"{title}: not compared with DCAC, which {trace.meta['ended']}", file=sys.stderr)
        return None
    return trace.head(ticks)


# --- plan ---


def plan_scenario(given: argparse.Namespace) -> int:
    """Plan, print, and write the course; returns 3 where no course goes all the way."""
    try:
        return _plan(given)
    except MocOptError as error:
        for argument, option in PLAN_OPTIONS.items():
            if str(error).startswith(argument):
                error.args = (str(error).replace(argument, option, 1),)
        raise


def _plan(given: argparse.Namespace) -> int:
    from moc_opt.report.console import print_json
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
    plan, within = followable_plan(
        scenario, given.margin, given.speed_share, objective=given.objective, acceleration=given.acceleration,
        margin_m=given.margin_m, followed=follows,
    )
    began, places = time.perf_counter(), []
    if given.place is not None:
        places = place(scenario, given.place, box_m=box_m, candidates=candidates, objective=given.objective, **within)
    took = time.perf_counter() - began
    warned = following_warnings(scenario, plan) if follows else []
    if given.json:
        searched = {"places": place_json(places), "place_s": took} if places else {}
        print_json(plan_json(plan) | {"within": within, "warnings": warned} | searched)
    else:
        tables = plan_tables(title, plan, **within)
        if places:
            tables.append(place_table(f"Places of the {given.place}", candidates, box_m, took, places))
        print_tables(tables)
        print(start_toml(scenario.robot.arm(), plan, places))
    for line in warned:  # last, below the tables
        print(f"{title}: warning: {line}", file=sys.stderr)
    if given.out is not None and plan.course is None:
        print(f"{title}: --out {given.out}: no course goes all the way: nothing is written", file=sys.stderr)
    elif given.out is not None:
        limits = {**within, "acceleration": given.acceleration}
        path = save_course(plan, scenario, given.out, limits)
        print(path, file=sys.stderr if given.json else sys.stdout)
    return 0 if plan.executable else 3
