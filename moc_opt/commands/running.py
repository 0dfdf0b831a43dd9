"""The commands `run`, `plant`, `control` and `plan`: one scenario is run, in one process or in two, or planned."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from moc_opt.commands.parser import check_paths
from moc_opt.errors import MocOptError, ScenarioError, UnknownNameError, shown
from moc_opt.inputs.files import decimal, read_text, to_json
from moc_opt.report.console import busy, console, print_json, progress
from moc_opt.report.document import check_out
from moc_opt.report.run_table import MATTER, below_best, part, refusals, run_json, run_table, warnings
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import RunAway, Scenario, Setup, run
from moc_opt.trace.file import check_trace, new_file
from moc_opt.trace.metrics import METRICS, load_plugins, summarize
from moc_opt.trace.trace import Trace

HEADINGS = (["x_m", "y_m", "z_m"], ["x", "y", "z"])
"""Names of the columns of a file of waypoints that are read as such, in this order and in metres."""
SPLIT = str.maketrans(",\"'", "   ")
PLAN_OPTIONS = {"margin_rad": "--margin", "margin_m": "--margin-m", "speed_share": "--speed-share"}
"""An argument as errors begin with it -> the option that gave it."""


def read_scenario(path: Path | None) -> tuple[Scenario, str]:
    """Return the scenario of a file, or the default one, and its name in messages."""
    scenario = Scenario() if path is None else Scenario.load(path)
    return scenario, scenario.name if path is None or "name" in scenario.model_fields_set else path.stem


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables as the screen has room for them."""
    screen = console()
    for table in tables:
        screen.print(table)


# --- run ---


def run_scenario(given: argparse.Namespace) -> int:
    """Run, summarise against DCAC with the same gains, print, save."""
    scenario, title = read_scenario(given.scenario)
    if "best_courses" not in scenario.model_fields_set:
        scenario = scenario.change(best_courses=True)
    scenario = changed(scenario, given)
    given.course = scenario.control.course or None  # the scenario's own file is not to be overwritten, either
    check_paths(given)
    if given.report is not None:
        check_out(given.report, "report", force=given.force)
    _keep_others(given)
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


def _keep_others(given: argparse.Namespace) -> None:
    """Refuse, before the run, to write its trace over a file that is none."""
    if given.trace is not None and not given.force:
        check_trace(given.trace)


def show(scenario: Scenario, title: str, trace: Trace, given: argparse.Namespace) -> int:
    """Print how a run ended, and its metrics; return the exit status."""
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
        from moc_opt.report.run_page import run_page  # plotly loads slowly

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
    if given.course == "":
        raise ScenarioError("--course '': give the file that `moc-opt plan --out` wrote")
    if given.course and given.third_level not in (None, "planned"):
        raise ScenarioError(f"--course {given.course}: only --third-level planned follows a file; leave one out")
    changes: dict[str, Any] = {}
    if given.seed is not None:
        changes["seed"] = given.seed
    if given.robot is not None:
        changes["robot"] = {"name": given.robot}
    if given.course is not None:
        changes["control"] = {"third_level": "planned", "course": given.course}
    elif given.third_level is not None:
        course = scenario.control.course if given.third_level == "planned" else ""
        changes["control"] = {"third_level": given.third_level, "course": course}
    if given.solver is not None:
        changes["solver"] = {"name": given.solver, "settings": {}}
    if given.task is not None:
        points = read_waypoints(given.task) if Path(given.task).suffix.lower() in (".csv", ".txt") else None
        path = given.task if points is None else "waypoints"
        changes["task"] = {"path": path, "sizes": {}, "waypoints_m": points}
    if given.metric:
        changes["metrics"] = tuple(given.metric)
    scenario = scenario.change(**changes)
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
    text = read_text(path, "waypoints", ScenarioError)
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    if lines and lines[0][1].lower().translate(SPLIT).split() in HEADINGS:
        del lines[0]
    points: list[tuple[float, ...]] = []
    for number, line in lines:
        point = tuple(map(decimal, line.replace(",", " ").split()))
        if len(point) != 3 or not all(map(math.isfinite, point)):
            cure = "give x, y, z [m]; the first line may name the columns, x_m,y_m,z_m, and any other begins with #"
            if len(point) == 4 and point[0] == len(points):
                cure = "four columns, the first one counts: give x, y, z [m] alone (in pandas: to_csv(index=False))"
            raise ScenarioError(f"waypoints {path!r}, line {number}: {shown(line, 60)}: {cure}")
        points.append(point)
    if not points:
        raise ScenarioError(f"waypoints {path!r}: there is no point in it: give x, y, z [m], one point a line")
    return points


def _matched_dcac(scenario: Scenario, title: str, ticks: int) -> Trace | None:
    """Return the first ticks of DCAC with the same gains; None, and a word on it, where it was stopped before."""
    try:
        matched = scenario.control.matched_dcac()
        trace = run(scenario.change(control=matched, bound_samples=0, best_courses=False))
    except RunAway as error:
        trace = error.trace
    if len(trace) < ticks or "mu" not in trace.columns:
        print(f"{title}: not compared with DCAC, which {trace.meta['ended']}", file=sys.stderr)
        return None
    return trace.head(ticks)


# --- plant and control: the two ends of a wire, each a process of its own ---


def run_plant(given: argparse.Namespace) -> int:
    """Wait for a controller, run against the clock, print as `run` does."""
    from moc_opt.realtime.clock import ask_for_realtime
    from moc_opt.realtime.wire import written
    from moc_opt.scenario.wired import PlantServer

    scenario, title = read_scenario(given.scenario)
    _keep_others(given)
    server = PlantServer(scenario, given.listen, given.key_file, lock_step=given.lock_step)
    print(f"listening on {written(server.address)}", file=sys.stderr, flush=True)
    server.system = {} if given.lock_step else ask_for_realtime()
    try:
        trace = server.trace(to=given.trace)
    except RunAway as error:
        trace = error.trace
    for name, value in trace.meta["wire"].items():
        if value:
            print(f"plant: {name}: {_words(value)}", file=sys.stderr)
    return show(scenario, f"{title}, plant", trace, given)


def run_control(given: argparse.Namespace) -> int:
    """Answer a plant until its run ends, and print how it went."""
    from moc_opt.realtime.clock import ask_for_realtime
    from moc_opt.scenario.wired import answer

    (scenario, title), granted = read_scenario(given.scenario), dict[str, str]()
    if scenario.control.third_level == "receding":
        print(
            "control: third_level = 'receding' solves within a tick, for some 10 ms: against the clock those ticks are "
            "missed; give the plant --lock-step, or take third_level = 'planned'", file=sys.stderr,
        )  # fmt: skip
    first = "plans its course, then " if scenario.control.follows else ""
    where = f"{given.connect}, for {scenario.wire.wait_s:g} s"
    print(f"control: {first}looks for a plant at {where}", file=sys.stderr, flush=True)
    found = answer(scenario, given.connect, given.key_file, ready=lambda: granted.update(ask_for_realtime()))
    if given.json:
        print_json(asdict(found) | {"system": granted})
    else:
        print_tables([_ending_table(title, asdict(found) | {"system": granted})])
    return 0 if found.ended == "completed" else 3


def _ending_table(title: str, found: dict[str, Any]) -> Table:
    """Return how the run looked from the controller's end, a row a figure; counts of zero are left out."""
    rows = []
    for name, value in found.items():
        if isinstance(value, dict):
            rows += [{"what": f"{name}: {key}", "value": _words(entry)} for key, entry in value.items() if entry]
        elif value:
            rows.append({"what": name, "value": _words(value)})
    return Table(f"Controller of {title}", [Column("what", "what"), Column("value", "value")], rows)


def _words(value: Any) -> str:
    if isinstance(value, dict) and value.keys() == {"count", "first_at_s", "first"}:  # of answers that were refused
        return f"{value['count']}, first at {value['first_at_s']:.3f} s: {value['first']}"
    return value if isinstance(value, str) else to_json(value, indent=None)


# --- plan ---


def plan_scenario(given: argparse.Namespace) -> int:
    """Plan, print, and write the course; returns 3 where no course goes all the way."""
    try:
        return _plan(given)
    except MocOptError as error:
        argument, _, rest = str(error).partition(" ")
        if argument in PLAN_OPTIONS:
            error.args = (f"{PLAN_OPTIONS[argument]} {rest.removeprefix('= ')}",)
        raise


def _plan(given: argparse.Namespace) -> int:
    from moc_opt.report.plan_table import plan_json, plan_tables, start_toml
    from moc_opt.scenario.planned import followable_plan, following_warnings, save_course

    scenario, title = read_scenario(given.scenario)
    if given.out is not None:
        new_file(given.out)  # before the search, which may take a minute
        if not given.force:
            check_trace(given.out)  # a course is one, too
    follows = scenario.control.follows or given.out is not None  # a course is written to be followed
    plan, within = followable_plan(
        scenario, given.margin, given.speed_share, given.margin_m, followed=follows,
    )
    warned = following_warnings(scenario, plan) if follows else []
    if given.json:
        print_json(plan_json(plan) | {"within": within, "warnings": warned})
    else:
        print_tables(plan_tables(title, plan, **within))
        print(start_toml(scenario.robot.arm(), plan))
    for line in warned:  # last, below the tables
        print(f"{title}: warning: {line}", file=sys.stderr)
    if given.out is not None and plan.course is None:
        print(f"{title}: --out {given.out}: no course goes all the way: nothing is written", file=sys.stderr)
    elif given.out is not None:
        path = save_course(plan, scenario, given.out, within)
        print(path, file=sys.stderr if given.json else sys.stdout)
    return 0 if plan.executable else 3
