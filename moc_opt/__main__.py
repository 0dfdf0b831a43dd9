"""python -m moc_opt run | plan | replay | map | live | export-c | robot: scenarios and robots from the command line."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from moc_opt.commissioning.command import add_commands as robot_commands
from moc_opt.commissioning.command import run_command as robot_command
from moc_opt.errors import MocOptError, describe

if TYPE_CHECKING:
    from moc_opt.scenario import Scenario
    from moc_opt.trace.trace import Trace


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns 0, 2 where the input is wrong, 3 where a run did not end "completed"."""
    parser = argparse.ArgumentParser(prog="python -m moc_opt", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser(
        "run", help="run one scenario and print its metrics",
        epilog="Exit status: 0 the run completed; 2 the input is wrong; 3 it was stopped, ran away or oscillated, "
        "and what is printed says so first; 130 interrupted, 1 a defect: with --trace the rows so far are there.",
    )  # fmt: skip
    one.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario runs")
    one.add_argument("--seed", type=int, help="replaces the scenario's seed")
    one.add_argument("--solver", help="replaces the scenario's solver")
    one.add_argument("--robot", metavar="NAME|MY.toml", help="replaces the scenario's robot")
    one.add_argument("--trace", type=Path, help="the trace goes here (Parquet) while the run grows")
    one.add_argument("--json", action="store_true", help="print JSON")
    c = commands.add_parser("export-c", help="write the scenario's controller, guard included, as dependency-free C")
    c.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    c.add_argument("--out", type=Path, required=True, help="folder, made if need be")
    ahead = commands.add_parser(
        "plan", help="say before anything moves whether and how well a scenario can be executed",
        epilog="Exit status: 0 the whole path can be executed from this start; 2 the input is wrong; 3 it cannot.",
    )  # fmt: skip
    ahead.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    ahead.add_argument("--objective", choices=("mean", "worst", "log"), default="mean", help="of mu along the path")
    ahead.add_argument("--margin", type=float, default=0.0, help="that joints keep from their limits [rad]")
    ahead.add_argument("--speed-share", type=float, default=1.0, help="of the joints' speed limits that may be used")
    ahead.add_argument("--acceleration", type=float, default=float("inf"), help="most of any joint [rad/s^2]")
    ahead.add_argument("--place", choices=("trocar", "base"), help="also search for the place of it that serves best")
    ahead.add_argument("--box", type=float, default=0.05, help="of the search: half the edge of its cube [m]")
    ahead.add_argument("--candidates", type=int, default=40, help="of the search")
    ahead.add_argument("--out", type=Path, help="the course goes here (Parquet)")
    ahead.add_argument("--json", action="store_true", help="print JSON")
    replay = commands.add_parser("replay", help="one to four saved traces in 3-D, as one HTML file")
    replay.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes")
    replay.add_argument("--out", type=Path, default=Path("replay.html"))
    chart = commands.add_parser("map", help="saved traces of one path on the manipulability map, as one HTML file")
    chart.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes")
    chart.add_argument("--out", type=Path, default=Path("map.html"))
    chart.add_argument("--figures", action="store_true", help="also as SVG and PDF, in a folder beside it")
    live = commands.add_parser("live", help="a scenario in real time, on a page of this machine")
    live.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    live.add_argument("--host", default="127.0.0.1", help="a loopback address")
    live.add_argument("--port", type=int, default=8642)
    live.add_argument("--i-know-this-is-public", action="store_true", dest="public", help="allow any other host")
    robot_commands(commands)
    given = parser.parse_args(arguments)
    try:
        if given.command == "robot":
            return robot_command(given)
        if given.command == "export-c":
            return export_c(given.scenario, given.out)
        if given.command == "plan":
            return plan_scenario(given)
        if given.command == "replay":
            from moc_opt.report.replay import Replay

            print(Replay.load(given.traces).save(given.out))
            return 0
        if given.command == "map":
            return draw_map(given.traces, given.out, given.figures)
        if given.command == "live":
            from moc_opt.live.page import serve
            from moc_opt.scenario import Scenario

            scenario = Scenario() if given.scenario is None else Scenario.load(given.scenario)
            return serve(scenario, host=given.host, port=given.port, public=given.public)
        return run_scenario(given.scenario, given.seed, given.solver, given.trace, given.json, given.robot)
    except (MocOptError, MemoryError) as error:
        print(_one_line(error), file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        print(_one_line(error), file=sys.stderr)
        return 130
    except Exception as error:
        if not hasattr(error, "__notes__"):
            raise
        print(_one_line(error), file=sys.stderr)  # a defect, in a run whose rows are safe
        return 1


def _one_line(error: BaseException) -> str:
    """What went wrong, and where what there is of the run is to be found."""
    said = "interrupted" if isinstance(error, KeyboardInterrupt) else f"{type(error).__name__}: {error}"
    where = ""
    if not isinstance(error, MocOptError | MemoryError | KeyboardInterrupt):
        at = traceback.extract_tb(error.__traceback__)[-1]
        said, where = describe(error), f" ({Path(at.filename).name}:{at.lineno})"
    return "; ".join([said + where, *getattr(error, "__notes__", [])])


def run_scenario(
    path: Path | None, seed: int | None, solver: str | None, trace_to: Path | None, as_json: bool,
    robot: str | None = None,
) -> int:  # fmt: skip
    """Run, summarise against DCAC with the same gains, print, save."""
    from moc_opt.report.console import console, print_json, progress
    from moc_opt.report.run_table import below_best, part, refusals, run_json, run_table, warnings
    from moc_opt.scenario import RunAway, Scenario, Setup
    from moc_opt.trace.metrics import summarize

    scenario = Scenario() if path is None else Scenario.load(path)
    title = scenario.name if path is None or "name" in scenario.model_fields_set else path.stem
    if "best_courses" not in scenario.model_fields_set:
        scenario = scenario.change(best_courses=True)
    if seed is not None:
        scenario = scenario.change(seed=seed)
    if robot is not None:
        scenario = scenario.change(robot={"name": robot})
    if solver is not None:
        scenario = scenario.change(solver={"name": solver, "settings": {}})
    setup = Setup(scenario)
    ticks = len(setup.times())
    with progress(title, ticks) as bar:
        try:
            trace = setup.trace(lambda tick: bar.advance(100) if tick % 100 == 0 else None, trace_to)
        except RunAway as error:
            trace = error.trace
    ended = str(trace.meta["ended"])
    if "earlier_run" in trace.meta:
        print(f"{title}: earlier run: {trace.meta['earlier_run']}", file=sys.stderr)
    for line in ([] if ended == "completed" else [f"{ended}{part(trace)}"]) + refusals(trace) + warnings(trace):
        print(f"{title}: {line}", file=sys.stderr)
    if below_best(trace):
        print(f"{title}: {below_best(trace)}", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder:
        beside = None if trace_to is None else Path(folder, "dcac.parquet")
        baseline = _matched_dcac(scenario, title, len(trace), beside) if scenario.control.law == "moc" else None
        metrics = summarize(trace, baseline)
    if as_json:
        print_json(run_json(trace, metrics))
    else:
        console().print(run_table(title, trace, metrics).to_rich())
    return 0 if ended == "completed" else 3


def plan_scenario(given: argparse.Namespace) -> int:
    """Plan, print, and write the course."""
    from moc_opt.report.console import console, print_json
    from moc_opt.report.plan_table import place_json, place_table, plan_json, plan_tables
    from moc_opt.scenario import Scenario
    from moc_opt.scenario.followable import following_warnings
    from moc_opt.scenario.placement import place
    from moc_opt.scenario.planned import plan, save_course

    scenario = Scenario() if given.scenario is None else Scenario.load(given.scenario)
    title = scenario.name if given.scenario is None or "name" in scenario.model_fields_set else given.scenario.stem
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


def _matched_dcac(scenario: Scenario, title: str, ticks: int, to: Path | None) -> Trace | None:
    """The first ticks of DCAC with the same gains; None, and a word on it, where it was stopped before."""
    from moc_opt.scenario import RunAway, run

    try:
        matched = scenario.control.matched_dcac()
        trace = run(scenario.change(control=matched, bound_samples=0, best_courses=False), to=to)
    except RunAway as error:
        trace = error.trace
    if len(trace) < ticks or "mu" not in trace.columns:
        print(f"{title}: not compared with DCAC, which {trace.meta['ended']}", file=sys.stderr)
        return None
    return trace.head(ticks)


def draw_map(traces: Sequence[Path], out: Path, figures: bool) -> int:
    """Write the page, then the figures: the page is there even where no browser can draw the files."""
    from moc_opt.report.export import save_figures
    from moc_opt.report.map_page import load_map

    page = load_map(traces)
    print(page.save(out))
    for file in save_figures(page.figures, out.parent / "figures") if figures else ():
        print(file)
    return 0


def export_c(path: Path | None, out: Path) -> int:
    """Write the whole controller as C, with recorded ticks for its self-tests; say how long its longest step is."""
    from moc_opt.scenario import Scenario
    from moc_opt.scenario.exported import export_scenario

    files, operations = export_scenario(Scenario() if path is None else Scenario.load(path), out)
    for file in files:
        print(file)
    parts = ", ".join(f"{part} {count}" for part, count in operations.items() if part != "in all")
    print(f"longest step: {operations['in all']} floating-point operations ({parts})")
    print(f"next: make -C {out} test, make -C {out} sanitize")
    return 0


if __name__ == "__main__":
    sys.exit(main())
