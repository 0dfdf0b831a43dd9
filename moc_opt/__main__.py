"""moc-opt, or python -m moc_opt: scenarios, robots and solvers from the command line."""

from __future__ import annotations

import argparse
import select
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from moc_opt import __version__
from moc_opt.commands import arguments as more
from moc_opt.commissioning.command import add_commands as robot_commands
from moc_opt.commissioning.command import run_command as robot_command
from moc_opt.errors import MocOptError, describe


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns 0, 2 where the input is wrong, 3 where a run did not end "completed"."""
    try:
        try:
            return _command(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        watched = select.poll()
        watched.register(sys.stdout.fileno(), 0)
        if not watched.poll(0):
            raise  # another pipe than that of the output
        from moc_opt.report.console import end_output

        return end_output()


def _command(arguments: Sequence[str] | None) -> int:
    parser = argparse.ArgumentParser(prog="moc-opt", description=__doc__)
    parser.add_argument("--version", action="version", version=f"moc-opt {__version__}")
    commands = parser.add_subparsers(dest="command")
    one = commands.add_parser(
        "run", help="run one scenario and print its metrics",
        epilog="Exit status: 0 the run completed; 2 the input is wrong; 3 it was stopped, ran away or oscillated, "
        "and what is printed says so first; 130 interrupted, 1 a defect: with --trace the rows so far are there.",
    )  # fmt: skip
    one.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario runs")
    one.add_argument("--seed", type=int, help="replaces the scenario's seed")
    one.add_argument("--solver", help="replaces the scenario's solver")
    one.add_argument("--robot", metavar="NAME|MY.toml", help="replaces the scenario's robot")
    one.add_argument("--task", metavar="NAME|POINTS.csv", help="replaces the path; a file: x,y,z [m] a line")
    one.add_argument("--metric", action="append", metavar="NAME", help="print this metric alone; may be repeated")
    one.add_argument("--all", action="store_true", help="print every metric, not those alone to look at first")
    one.add_argument("--report", type=Path, metavar="FILE.html", help="metrics, curves and map of the run go here")
    one.add_argument(
        "--third-level", choices=("local", "planned", "receding"), help="replaces the scenario's [control] third_level"
    )
    one.add_argument("--trace", type=Path, help="the trace goes here (Parquet) while the run grows")
    one.add_argument("--json", action="store_true", help="print JSON")
    c = commands.add_parser("export-c", help="write the scenario's controller, guard included, as dependency-free C")
    c.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    c.add_argument("--out", type=Path, required=True, help="folder, made if need be")
    c.add_argument("--main", choices=("test", "udp"), default="test", help="udp: also a controller for `plant`")
    ahead = commands.add_parser(
        "plan", help="say before anything moves whether and how well a scenario can be executed",
        epilog="Exit status: 0 the whole path can be executed from this start; 2 the input is wrong; 3 it cannot.",
    )  # fmt: skip
    ahead.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    ahead.add_argument(
        "--objective", choices=("mean", "worst", "log"), default="mean",
        help="what is made large: mean or worst mu along the path, or the mean of its logarithm",
    )
    ahead.add_argument(
        "--margin", type=float, metavar="RAD",
        help="what joints keep from their limits; default 0, or what a third level that follows a course keeps",
    )
    ahead.add_argument("--margin-m", type=float, metavar="M", help="the same for a joint that slides")
    ahead.add_argument(
        "--speed-share", type=float, metavar="S",
        help="share of the joints' speed limits that may be used, above 0 to 1; default 1, or what that level uses",
    )
    ahead.add_argument(
        "--acceleration", type=float, default=float("inf"), metavar="A",
        help="largest of any joint [rad/s^2]; default: no limit",
    )
    ahead.add_argument("--place", choices=("trocar", "base"), help="also search for the place of it that serves best")
    ahead.add_argument(
        "--box", type=float, metavar="M", help="with --place: half the edge of the cube searched; default 0.05"
    )
    ahead.add_argument("--candidates", type=int, metavar="N", help="with --place: places that are tried; default 40")
    ahead.add_argument("--out", type=Path, metavar="FILE.parquet", help="the course to follow goes here")
    ahead.add_argument("--json", action="store_true", help="print JSON")
    replay = commands.add_parser("replay", help="one to four saved traces in 3-D, as one HTML file")
    replay.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes")
    replay.add_argument("--out", type=Path, default=Path("replay.html"), help="default replay.html")
    chart = commands.add_parser("map", help="saved traces of one path on the manipulability map, as one HTML file")
    chart.add_argument("traces", nargs="+", type=Path, help="Parquet, as `run --trace` writes")
    chart.add_argument("--out", type=Path, default=Path("map.html"), help="default map.html")
    chart.add_argument("--figures", action="store_true", help="also as SVG and PDF, in a folder beside it")
    live = commands.add_parser("live", help="a scenario in real time, on a page of this machine")
    live.add_argument("scenario", nargs="?", type=Path, help="TOML; without it the default scenario")
    live.add_argument("--host", default="127.0.0.1", help="a loopback address; default 127.0.0.1")
    live.add_argument("--port", type=int, default=8642, help="0 to 65535, 0: any that is free; default 8642")
    live.add_argument("--i-know-this-is-public", action="store_true", dest="public", help="allow any other host")
    plant = commands.add_parser(
        "plant", help="the plant of a scenario in real time, for a controller at the other end of a wire",
        epilog="Exit status as of `run`. docs/realtime.md describes the wire.",
    )  # fmt: skip
    plant.add_argument("--listen", metavar="HOST:PORT", default="127.0.0.1:30200", help="default 127.0.0.1:30200")
    plant.add_argument("--lock-step", action="store_true", help="wait for each command instead of keeping the time")
    plant.add_argument("--trace", type=Path, help="the trace goes here (Parquet)")
    plant.add_argument("--all", action="store_true", help="print every metric, not those alone to look at first")
    control = commands.add_parser(
        "control", help="the controller of a scenario, for a plant at the other end of a wire",
        epilog="Exit status: 0 the plant ended the run; 2 the input is wrong; 3 the controller asked for a stop, or "
        "the plant fell silent.",
    )  # fmt: skip
    control.add_argument("--connect", metavar="HOST:PORT", default="127.0.0.1:30200", help="default 127.0.0.1:30200")
    for end in (plant, control):
        end.add_argument("scenario", nargs="?", type=Path, help="TOML, the same at both ends; without it the default")
        end.add_argument("--key-file", type=Path, help="one line of 16 to 32 bytes; else MOC_OPT_WIRE_KEY")
        end.add_argument("--json", action="store_true", help="print JSON")
    robot_commands(commands)
    more.add_commands(commands)
    given, rest = parser.parse_known_args(arguments)
    if given.command is None:
        parser.error("no command: `moc-opt run` runs the default scenario, `moc-opt -h` says what each command does")
    if rest and (given.command != "solvers" or given.list):
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    try:
        more.check_paths(given)
        if given.command in more.NAMES:
            return more.run_command(given, rest)
        if given.command == "robot":
            return robot_command(given)
        if given.command == "export-c":
            return export_c(given.scenario, given.out, given.main)
        if given.command == "plan":
            from moc_opt.commands.ahead import plan_scenario

            return plan_scenario(given)
        if given.command == "replay":
            from moc_opt.report.document import check_out
            from moc_opt.report.replay import Replay

            check_out(given.out, "replay")
            print(Replay.load(given.traces).save(given.out))
            return 0
        if given.command == "map":
            return draw_map(given.traces, given.out, given.figures)
        if given.command == "live":
            from moc_opt.live.page import serve
            from moc_opt.scenario import Scenario

            scenario = Scenario() if given.scenario is None else Scenario.load(given.scenario)
            named = "name" in scenario.model_fields_set
            title = scenario.name if named else scenario.task.path if given.scenario is None else given.scenario.stem
            return serve(scenario, host=given.host, port=given.port, public=given.public, title=title)
        if given.command in ("plant", "control"):
            from moc_opt.commands.wire import run_control, run_plant

            return (run_plant if given.command == "plant" else run_control)(given)
        from moc_opt.commands.running import run_scenario

        return run_scenario(given)
    except (MocOptError, MemoryError) as error:
        print(_one_line(error), file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        print(_one_line(error), file=sys.stderr)
        return 130
    except Exception as error:
        if isinstance(error, BrokenPipeError) or not hasattr(error, "__notes__"):
            raise
        print(_one_line(error), file=sys.stderr)  # a defect, in a run whose rows are safe
        return 1


def _one_line(error: BaseException) -> str:
    """Return what went wrong, and where what there is of the run is to be found."""
    said = "interrupted" if isinstance(error, KeyboardInterrupt) else f"{type(error).__name__}: {error}"
    where = ""
    if not isinstance(error, MocOptError | MemoryError | KeyboardInterrupt):
        at = traceback.extract_tb(error.__traceback__)[-1]
        said, where = describe(error), f" ({Path(at.filename).name}:{at.lineno})"
    return "; ".join([said + where, *getattr(error, "__notes__", [])])


def draw_map(traces: Sequence[Path], out: Path, figures: bool) -> int:
    """Write the page, then the figures: the page is there even where no browser can draw the files."""
    from moc_opt.report.document import check_out
    from moc_opt.report.export import save_figures
    from moc_opt.report.map_page import load_map

    check_out(out, "map")
    page = load_map(traces)
    print(page.save(out))
    for file in save_figures(page.figures, out.parent / "figures") if figures else ():
        print(file)
    return 0


def export_c(path: Path | None, out: Path, main: str = "test") -> int:
    """Write the whole controller as C, with recorded ticks for its self-tests; say how long its longest step is."""
    from moc_opt.commands.running import read_scenario
    from moc_opt.scenario.exported import export_scenario

    scenario, _ = read_scenario(path)
    files, operations = export_scenario(scenario, out, udp=main == "udp")
    for file in files:
        print(file)
    parts = ", ".join(f"{part} {count}" for part, count in operations.items() if part != "in all")
    print(f"longest step: {operations['in all']} floating-point operations ({parts})")
    print(f"next: make -C {out} test, make -C {out} sanitize")
    if main == "udp":
        print(f"then: make -C {out} moc_udp, {out}/moc_udp 127.0.0.1 30200 {out}/reference.bin")
    return 0


if __name__ == "__main__":
    sys.exit(main())
