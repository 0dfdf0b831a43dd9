"""The first screen, the tables and the page of ``python -m benchmarks.realtime``, all from its numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from benchmarks.common.answer import Answer, Picture, marked_answer
from benchmarks.latency.report import GOALS
from benchmarks.latency.wire import SAFE_RCM_M, Case, Found
from moc_opt.comparison.statistics import spread
from moc_opt.figures.style import Styles, figure, legend_height, log_axis, rule
from moc_opt.numerics.arrays import Array
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

Runs = Mapping[Case, Sequence[Found]]
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99_99": 99.99, "worst": 100.0}
TIMES = {"wake": "wake-up latency", "round": "round trip", "control": "controller"}
BINS = 120
NAMES = {"python": "Python", "c": "C"}
CYCLES, LATENCY, TAILS = "Cycles and stops", "Latencies", "Histograms of every time"

CASES = [
    Column("name", "case"),
    Column("goal", "goal", help="few misses where the machine is quiet, no harm where it is loaded"),
    Column("missed", "missed", format="d", section=CYCLES, help="round trips that took longer than the period"),
    Column("cycles", "of", section=CYCLES, help="cycles"),
    Column("round_p50_us", "p50", unit="us", format=".0f", section=LATENCY, help="median round trip"),
    Column("round_p99_99_us", "p99.99", unit="us", format=".0f", section=LATENCY, help="one in ten thousand is slower"),
    Column("round_worst_us", "worst", unit="us", format=".0f", section=LATENCY),
    Column("rcm_max_mm", "RCM", unit="mm", format=".2f", section=CYCLES,
           help="largest error from the registered trocar"),
]  # fmt: skip
OUTCOMES = [
    Column("name", "case"), Column("cycles", "cycles", format="d"), Column("missed", "missed", format="d"),
    Column("overruns", "plant stalled", format="d", help="the plant's own process was not run for a period"),
    Column("stopped", "stops", format="d"), Column("unclean", "not clean", format="d"),
    Column("rcm_max_mm", "RCM", unit="mm", format=".2f", help="largest error from the registered trocar"),
]  # fmt: skip
LATENCIES = [
    Column("name", "case"), Column("what", "time"),
    *(Column(p, p.replace("_", "."), unit="us", format=".0f") for p in PERCENTILES),
]  # fmt: skip


def samples(runs: Sequence[Found], time: str) -> Array:
    """Return the times of all cycles [us], but for those without one."""
    values = np.concatenate([getattr(run, f"{time}_us") for run in runs])
    return values[np.isfinite(values)]


def histogram(times: Mapping[str, Array], deadline_us: float | None = None) -> go.Figure:
    """Draw how many cycles took how long, both axes logarithmic: one late cycle of a million is seen."""
    drawn, styles = figure(legend_y=1.08, height=320 + legend_height(times)), Styles(times)
    ends = np.concatenate([np.maximum(values, 1.0)[[values.argmin(), values.argmax()]] for values in times.values()])
    edges = np.geomspace(0.95 * ends.min(), 1.05 * ends.max(), BINS + 1)
    for name, values in times.items():
        counts = np.histogram(np.maximum(values, 1.0), edges)[0]
        drawn.add_scatter(
            x=np.sqrt(edges[1:] * edges[:-1]), y=np.where(counts > 0, counts, np.nan), name=name, mode="lines+markers",
            line={"color": styles[name].color, "shape": "hvh", "width": 1.4}, marker={"size": 3}, connectgaps=False,
        )  # fmt: skip
    log_axis(drawn, "x", "time [us]", edges if deadline_us is None else [*edges, deadline_us])
    log_axis(drawn, "y", "cycles", [0.8, max(len(values) for values in times.values())], powers=True)
    if deadline_us is not None:
        rule(drawn, "x", deadline_us, "deadline")
    return drawn


def answer(summary: Mapping[str, Any], runs: Runs) -> Answer:
    """Make the first screen: who meets a period, what a miss does to the patient, and what the tails look like."""
    order = sorted(summary["cases"], key=lambda name: (int(name.split(", ")[1][:-3]), name.endswith("loaded"), name))
    rows = [{"name": case_name(name), "goal": _goal(summary, name), **summary["cases"][name]} for name in order]
    table = Table(
        "Round trips over the wire, against the period", CASES, rows,
        "goal: met or missed where there is one (C at most 1 in 100,000 and Python 1 in 1,000 at 500 Hz, quiet, open "
        "where the 95 % interval holds that; under load no RCM error above "
        f"{1e3 * SAFE_RCM_M:g} mm and no stop that is not clean).",
    )  # fmt: skip
    pictures = list(_pictures(runs))
    return marked_answer(sentences(summary), table, pictures)


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """Say how many cycles missed on a quiet machine, what load does, and how many goals are reached; computed."""
    cases, said = summary["cases"], []
    quiet = {name: found for name, found in cases.items() if name.endswith("quiet")}
    if quiet:
        each = [f"{case_name(name, 2)} {found['missed']} of {found['cycles']:,}" for name, found in quiet.items()]
        stalled = sum(found["overruns"] for found in quiet.values())
        said.append(
            f"Cycles missed on a quiet machine: {'; '.join(each)}; {stalled} times the plant's own process was not run "
            "for a period."
        )
    loaded = [found for name, found in cases.items() if name.endswith("loaded")]
    if loaded:
        rcm, unclean = max(found["rcm_max_mm"] for found in loaded), sum(found["unclean"] for found in loaded)
        missed, cycles = (sum(found[key] for found in loaded) for key in ("missed", "cycles"))
        said.append(
            f"With every core busy {missed} of {cycles:,} were missed, the largest RCM error was {rcm:.2f} mm, and "
            f"{f'{unclean} stops were not clean' if unclean else 'no run ended in a stop that was not clean'}."
        )
    goals = [goal["reached"] for goal in summary["goals"].values()]
    missed_goals = [goal["what"] for goal in summary["goals"].values() if goal["reached"] == "no"]
    text = f"{goals.count('yes')} of {len(goals)} goals are reached"
    text += "".join(f", {goals.count(word)} {word}" for word in ("open", "not measured") if word in goals)
    return [*said, text + (f"; missed: {'; '.join(missed_goals)}." if missed_goals else ".")]


def case_name(case: str, parts: int = 3) -> str:
    """Return a case's name in words, or its first parts."""
    controller, *rest = case.split(", ")
    return ", ".join([NAMES[controller], *rest][:parts])


def _goal(summary: Mapping[str, Any], case: str) -> str | None:
    """Of a case: "met", "missed", "open", "not measured"; None where there is no goal for it."""
    found = summary["cases"][case]
    if case.endswith("loaded"):
        return "met" if found["rcm_max_mm"] <= 1e3 * SAFE_RCM_M and not found["unclean"] else "missed"
    if not case.endswith("500 Hz, quiet"):
        return None
    reached = summary["goals"][case.partition(",")[0]]["reached"]
    return {"yes": "met", "no": "missed"}.get(reached, reached)


def _pictures(runs: Runs) -> Iterator[Picture]:
    """Yield histograms: the round trip at each rate, and how late the plant wakes up at the first of them."""
    rates = sorted({case.rate_Hz for case in runs})
    for rate in rates[:2]:
        late = {f"{NAMES[c.controller]}, {c.load}": sum(run.missed for run in found)
                for c, found in runs.items() if c.rate_Hz == rate}  # fmt: skip
        worst = max(late, key=lambda name: late[name])
        beyond = f"beyond it most often {worst} ({late[worst]} cycles)" if late[worst] else "no cycle is beyond it"
        says = f"Round trips at {rate} Hz: the bulk should lie far left of the deadline; {beyond}."
        yield Picture(histogram(_of(runs, rate, "round"), 1e6 / rate), says, f"round-{rate}")
    if rates:
        says = (
            f"Wake-up latency at {rates[0]} Hz: the tail to the right is the operating system's, before any controller "
            "begins."
        )
        yield Picture(histogram(_of(runs, rates[0], "wake")), says, f"wake-{rates[0]}")


def _of(runs: Runs, rate: int, time: str) -> dict[str, Array]:
    return {f"{NAMES[c.controller]}, {c.load}": samples(found, time) for c, found in runs.items() if c.rate_Hz == rate}


def tables(summary: Mapping[str, Any]) -> list[Table]:
    """Return goals and figures."""
    goals = [
        {**of, "goal": f"{of['goal']:g}", "value": spread(of, "value")}
        for of in summary["goals"].values()
    ]
    cases = [(case_name(name), found) for name, found in summary["cases"].items()]
    latencies = [
        {"name": name, "what": title, **{p: found[f"{time}_{p}_us"] for p in PERCENTILES}}
        for time, title in TIMES.items() for name, found in cases
    ]  # fmt: skip
    outcomes = [{"name": name, **found} for name, found in cases]
    return [Table("Goals", GOALS, goals), Table(CYCLES, OUTCOMES, outcomes), Table(LATENCY, LATENCIES, latencies)]


def report(summary: Mapping[str, Any], runs: Runs, first: Answer, environment: Mapping[str, Any]) -> Page:
    """Make the page: the first screen, and folded below it everything else."""
    page = Page("Against the clock", "plant and controller as two processes with a UDP wire between them")
    first.begin(page)
    goals, cycles, latencies = tables(summary)
    page.section("How to read this")
    page.text(
        "Wake-up latency: how late the plant's tick begins. Round trip: from the departure of a measurement to the "
        "arrival of its torque, over the loopback; a cycle is missed where that takes longer than the period. "
        "Controller: safety filter and control law alone. `environment` says which priority, memory and timers the two "
        "processes were granted; Python's collector is off inside both loops."
    )
    page.table(goals)
    page.section(CYCLES)
    page.table(cycles)
    page.section(LATENCY)
    page.table(latencies)
    page.section(TAILS)
    for rate in sorted({case.rate_Hz for case in runs}):
        for time, title in TIMES.items():
            of, deadline = _of(runs, rate, time), 1e6 / rate if time == "round" else None
            if f"{time}-{rate}" not in page.figures:
                page.figure(histogram(of, deadline), f"{title.capitalize()} at {rate} Hz: how many cycles took how "
                            "long.", name=f"{time}-{rate}")  # fmt: skip
    page.environment(environment)
    return page
