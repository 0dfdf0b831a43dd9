"""The commands `plant` and `control`: a run whose two ends are processes of their own."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from typing import Any

from moc_opt.commands.running import read_scenario, show
from moc_opt.inputs.files import to_json
from moc_opt.report.tables import Column, Table


def run_plant(given: argparse.Namespace) -> int:
    """Wait for a controller, run against the clock, print as `run` does."""
    from moc_opt.realtime.clock import ask_for_realtime
    from moc_opt.realtime.link import read_key, written
    from moc_opt.scenario import RunAway
    from moc_opt.scenario.wired import PlantServer

    scenario, title = read_scenario(given.scenario)
    server = PlantServer(scenario, given.listen, read_key(given.key_file), lock_step=given.lock_step)
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
    from moc_opt.realtime.link import read_key
    from moc_opt.report.console import console, print_json
    from moc_opt.scenario.wired import answer

    (scenario, title), granted = read_scenario(given.scenario), dict[str, str]()
    key = read_key(given.key_file)
    if scenario.control.third_level == "receding":
        print(
            "control: third_level = 'receding' solves within a tick, for some 10 ms: against the clock those ticks are "
            "missed; give the plant --lock-step, or take third_level = 'planned'", file=sys.stderr,
        )  # fmt: skip
    first = "plans its course, then " if scenario.control.follows else ""
    where = f"{given.connect}, for {scenario.wire.wait_s:g} s"
    print(f"control: {first}looks for a plant at {where}", file=sys.stderr, flush=True)
    found = answer(scenario, given.connect, key, ready=lambda: granted.update(ask_for_realtime()))
    if given.json:
        print_json(asdict(found) | {"system": granted})
    else:
        console().print(_ending_table(title, asdict(found) | {"system": granted}).to_rich())
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
