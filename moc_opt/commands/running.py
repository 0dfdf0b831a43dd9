"""The commands `run`, `plant`, `control` and `plan`."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from moc_opt.errors import ScenarioError, TraceError, UnknownNameError, shown
from moc_opt.inputs.files import decimal, read_text, to_json
from moc_opt.report.console import Bar, busy, console, print_json
from moc_opt.report.document import check_out
from moc_opt.report.run_table import MATTER, part, remarks, run_json, run_tables
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import RunAway, Scenario, Setup, run
from moc_opt.tasks.paths import kinds
from moc_opt.trace.file import check_trace, new_file
from moc_opt.trace.metrics import METRICS, evaluate, load_plugins
from moc_opt.trace.trace import Trace, about

POINTS = "give x, y, z [m], one point per line; the first line may name the columns (x_m,y_m,z_m), # begins a comment"


def read_scenario(path: Path | None) -> tuple[Scenario, str]:
    """Return (scenario, title). Without a ``path``, the scenario is the default one."""
    scenario = Scenario() if path is None else Scenario.load(path)
    return scenario, scenario.name if path is None or "name" in scenario.model_fields_set else path.stem


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables."""
    screen = console()
    for place, table in enumerate(tables):
        if place:
            screen.print()
        screen.print(table)


# --- run ---


def run_scenario(given: argparse.Namespace) -> int:
    """Run a scenario, print its metrics and write its files."""
    scenario, title = read_scenario(given.scenario)
    if "best_courses" not in scenario.model_fields_set:
        scenario = scenario.change(best_courses=True)
    scenario = changed(scenario, given)
    title = scenario.task.path if given.scenario is None else title
    if given.trace and scenario.control.course and given.trace.resolve() == Path(scenario.control.course).resolve():
        raise TraceError(f"--trace {given.trace}: the run follows the course in that file; give another name")
    if given.trace and given.report and given.trace.resolve() == given.report.resolve():
        raise TraceError(f"--trace {given.trace}: --report names the same file; give another name")
    if given.report is not None:
        check_out(given.report, "report", force=given.force)
    _check_trace_out(given.trace, given.force)
    with Bar(title, now="sets up") as bar:
        setup = Setup(scenario)
        bar.of(len(setup.times()))
        watch: Callable[[int], None] = lambda tick: bar.step(steps=100) if tick % 100 == 99 else None  # noqa: E731
        trace = _as_far_as_it_goes(lambda: setup.trace(watch, given.trace))
    return show(scenario, title, trace, given)


def _check_trace_out(file: Path | None, force: bool, kind: str = "run") -> None:
    if file is not None:
        new_file(file)
        if not force:
            check_trace(file, kind)


def _as_far_as_it_goes(make: Callable[[], Trace]) -> Trace:
    try:
        return make()
    except RunAway as error:
        return error.trace


def show(scenario: Scenario, title: str, trace: Trace, given: argparse.Namespace) -> int:
    """Print how a run ended and its metrics, and write its report; return the exit status."""
    ended = str(trace.meta["ended"])
    for line in [*([] if ended == "completed" else [f"{ended}{part(trace)}"]), *remarks(trace)]:
        print(f"{title}: {line}", file=sys.stderr)
    if given.trace is not None:
        print(given.trace, file=sys.stderr)
    try:
        baseline = _matched_dcac(scenario, title, len(trace)) if scenario.control.law == "moc" else None
        metrics, lacking = evaluate(trace, baseline)
        if getattr(given, "report", None) is not None:  # `plant` has no --report
            from moc_opt.report.run_page import run_page  # plotly loads slowly

            own = about(trace)["solver"]
            runs = {own: trace} if baseline is None else {"DCAC (same gains)": baseline, own: trace}
            page = run_page(runs, {own: metrics}, scenario.robot.arm())
            print(page.save(given.report, force=given.force), file=sys.stderr)
    except KeyboardInterrupt as stop:
        if given.trace is not None:
            stop.add_note(f"the whole run is in {given.trace}")
        raise
    for name in dict.fromkeys(scenario.metrics):
        if name in lacking:
            print(f"{title}: this run has no metric {name}: {lacking[name]}", file=sys.stderr)
    wanted = {name: metrics[name] for name in scenario.metrics if name in metrics} if scenario.metrics else metrics
    if given.json:
        print_json(run_json(trace, wanted))
    else:
        short = not scenario.metrics and not given.all
        print_tables(run_tables({title: trace}, {title: wanted}, first=short))
        if short:
            hidden = len(set(metrics) - set(MATTER))
            console().print(f"{hidden} more metrics with `--all`; `moc-opt metrics` explains each.", markup=False)
        if busy():
            console().print(busy(), soft_wrap=True)
    return 0 if ended == "completed" else 3


def changed(scenario: Scenario, given: argparse.Namespace) -> Scenario:
    """Return the scenario, changed by the options of `moc-opt run`."""
    if given.course == "":
        raise ScenarioError("--course '': give the file that `moc-opt plan --out` wrote")
    if given.course and given.third_level not in (None, "planned"):
        raise ScenarioError(f"--course {given.course}: only --third-level planned follows a file; omit --course")
    changes: dict[str, Any] = {} if given.seed is None else {"seed": given.seed}
    if given.robot is not None:
        changes["robot"] = {"name": given.robot}
    if given.solver is not None:
        if scenario.control.law == "dcac":
            raise ScenarioError(f"--solver {given.solver}: [control] law = 'dcac' has no solver: use law = 'moc'")
        changes["solver"] = {"name": given.solver, "settings": {}}
    level = "planned" if given.course is not None else given.third_level
    if level is not None:
        course = given.course or (scenario.control.course if level == "planned" else "")
        changes["control"] = {"third_level": level, "course": course}
    if given.task is not None:
        kind = Path(given.task).suffix.lower()
        if kind not in ("", ".csv", ".txt") and given.task not in kinds():
            raise ScenarioError(f"--task {given.task}: give the name of a path, or a file of points (.csv or .txt)")
        points = read_waypoints(given.task) if kind in (".csv", ".txt") else None
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


def read_waypoints(path: str) -> list[list[float]]:
    """Read points x, y, z [m], one per line. Raises a ScenarioError for a wrong line."""
    points: list[list[float]] = []
    for number, line in enumerate(read_text(path, "waypoints", ScenarioError).splitlines(), start=1):
        words = re.sub("[,\"']", " ", line.partition("#")[0]).split()
        if not words or (not points and [word.lower().removesuffix("_m") for word in words] == ["x", "y", "z"]):
            continue
        points.append([decimal(word) for word in words])
        if len(words) != 3 or not all(map(math.isfinite, points[-1])):
            raise ScenarioError(f"waypoints {path!r}, line {number}: {shown(line, 60)}: {POINTS}")
    if not points:
        raise ScenarioError(f"waypoints {path!r}: the file contains no point: {POINTS}")
    return points


def _matched_dcac(scenario: Scenario, title: str, ticks: int) -> Trace | None:
    """Run DCAC with equal gains; return its first ``ticks`` ticks, or None if it ended earlier."""
    matched = scenario.change(control=scenario.control.matched_dcac(), bound_samples=0, best_courses=False)
    trace = _as_far_as_it_goes(lambda: run(matched))
    if len(trace) < ticks or "mu" not in trace.columns:
        print(f"{title}: not compared with DCAC, whose run ended earlier: {trace.meta['ended']}", file=sys.stderr)
        return None
    return trace.head(ticks)


# --- plant and control ---


def run_plant(given: argparse.Namespace) -> int:
    """Run the plant in this process, for a controller in another process."""
    from moc_opt.realtime.clock import ask_for_realtime
    from moc_opt.realtime.wire import written
    from moc_opt.scenario.wired import PlantServer

    scenario, title = read_scenario(given.scenario)
    _check_trace_out(given.trace, given.force)
    server = PlantServer(scenario, given.listen, given.key_file, lock_step=given.lock_step)
    print(f"listening on {written(server.address)}", file=sys.stderr, flush=True)
    server.system = {} if given.lock_step else ask_for_realtime()
    trace = _as_far_as_it_goes(lambda: server.trace(to=given.trace))
    for name, value in trace.meta["wire"].items():
        if value:
            print(f"plant: {name}: {_words(value)}", file=sys.stderr)
    return show(scenario, f"{title}, plant", trace, given)


def run_control(given: argparse.Namespace) -> int:
    """Run the controller in this process, for a plant in another process."""
    from moc_opt.realtime.clock import ask_for_realtime
    from moc_opt.scenario.wired import answer

    (scenario, title), granted = read_scenario(given.scenario), dict[str, str]()
    if scenario.control.third_level == "receding":
        print(
            "control: third_level = 'receding' replans within a tick. This takes about 10 ms, so in real time the "
            "tick's command is late; start the plant with --lock-step, or use third_level = 'planned'", file=sys.stderr,
        )  # fmt: skip
    first = "planning the course, then " if scenario.control.follows else ""
    where = f"{given.connect}, for up to {scenario.wire.wait_s:g} s"
    print(f"control: {first}waiting for a plant at {where}", file=sys.stderr, flush=True)
    found = answer(scenario, given.connect, given.key_file, ready=lambda: granted.update(ask_for_realtime()))
    told = found | {"system": granted}
    if given.json:
        print_json(told)
    else:
        flat = {name: value for name, value in told.items() if not isinstance(value, dict)}
        flat |= {f"{name}: {key}": v for name, of in told.items() if isinstance(of, dict) for key, v in of.items()}
        rows = [{"what": name, "value": _words(value)} for name, value in flat.items() if value]  # omits counts of 0
        print_tables([Table(f"Controller of {title}", [Column("what", "what"), Column("value", "value")], rows)])
    return 0 if found["ended"] == "completed" else 3


def _words(value: Any) -> str:
    if isinstance(value, dict) and value.keys() == {"count", "first_at_s", "first"}:  # refused answers
        return f"{value['count']}, first at {value['first_at_s']:.3f} s: {value['first']}"
    return value if isinstance(value, str) else to_json(value, indent=None)


# --- plan ---


def plan_scenario(given: argparse.Namespace) -> int:
    """Plan a scenario and print the plan; return 3 if the arm cannot follow the path."""
    from moc_opt.report.plan_table import plan_json, plan_tables, start_toml
    from moc_opt.scenario.planned import followable_plan, following_warnings, save_course

    scenario, title = read_scenario(given.scenario)
    _check_trace_out(given.out, given.force, "course")
    follows = scenario.control.follows or given.out is not None  # --out saves a course that a later run follows
    plan, within = followable_plan(scenario, given.margin, given.speed_share, given.margin_m, followed=follows)
    warned = following_warnings(scenario, plan) if follows else []
    path = save_course(plan, scenario, given.out, within) if given.out is not None and plan.course is not None else None
    if given.json:
        print_json(plan_json(plan) | {"within": within, "warnings": warned})
    else:
        print_tables(plan_tables(title, plan, **within))
        if start := start_toml(scenario.robot.arm(), plan):
            print(f"\n{start}")
    for line in warned:
        print(f"{title}: warning: {line}", file=sys.stderr)
    if path is not None:
        print(path, file=sys.stderr if given.json else sys.stdout)
    elif given.out is not None:
        print(f"{title}: --out {given.out}: no course reaches the end of the path: nothing is written", file=sys.stderr)
    return 0 if plan.executable else 3
