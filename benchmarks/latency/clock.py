"""What ``python -m benchmarks.realtime`` shows: its first screen, its page, and its section of docs/realtime.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import markdown
from benchmarks.common.answer import Answer, Picture, marked_answer
from benchmarks.common.goals import Goal, goal_table, goals_in_words
from benchmarks.latency.wire import SAFE_RCM_M, Case, Found
from moc_opt.arrays import Array
from moc_opt.figures import latency_ecdf
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

Runs = Mapping[Case, Sequence[Found]]
PAGE, SECTION = Path(__file__).resolve().parents[2] / "docs" / "realtime.md", "realtime"
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99_99": 99.99, "worst": 100.0}
TIMES = {"wake": "wake-up latency", "round": "round trip", "control": "controller"}
NAMES = {"python": "Python", "c": "C"}
DETAILS = "Cycles, times and stops"

_COLUMNS = {
    "name": Column("name", "case"),
    "goal": Column("goal", "goal", help="few misses where the machine is quiet, no harm where it is loaded"),
    "missed": Column("missed", "missed", format="d", section=DETAILS,
                     help="round trips that took longer than the period"),
    "cycles": Column("cycles", "cycles", section=DETAILS),
    "in_100000": Column("in_100000", "in 100,000", help="of the missed, with the 95 % interval"),
    "overruns": Column("overruns", "plant stalled", format="d", help="the plant's process was not run for a period"),
    **{time: Column(time, title, unit="us") for time, title in TIMES.items()},
    **{f"round_{p}_us": Column(f"round_{p}_us", p.replace("_", "."), unit="us", format=".0f", section=DETAILS)
       for p in PERCENTILES},
    "stopped": Column("stopped", "stops", format="d"),
    "unclean": Column("unclean", "not clean", format="d", help="stops"),
    "rcm_max_mm": Column("rcm_max_mm", "RCM error, worst", unit="mm", format=".2f", section=DETAILS),
}  # fmt: skip
FIRST = ("name", "goal", "missed", "cycles", "round_p50_us", "round_p99_99_us", "round_worst_us", "rcm_max_mm")
WHOLE = ("name", "cycles", "missed", "in_100000", "overruns", *TIMES, "stopped", "unclean", "rcm_max_mm")


def case_rows(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row a case, slow rates and quiet machines first; its times as median / p99 / p99.99 / worst."""
    order = sorted(summary["cases"], key=lambda name: (int(name.split(", ")[1][:-3]), name.endswith("loaded"), name))
    rows = []
    for name in order:
        found = summary["cases"][name]
        low, value, high = (1e5 * found[f"missed_share{end}"] for end in ("_low", "", "_high"))
        times = {time: " / ".join(f"{found[f'{time}_{p}_us']:,.0f}" for p in PERCENTILES) for time in TIMES}
        share = f"{value:.2g} [{low:.2g}, {high:.2g}]"
        rows.append(
            {**found, **times, "name": case_name(name), "goal": _goal(summary, name), "in_100000": share}
        )
    return rows


def samples(runs: Sequence[Found], time: str) -> Array:
    """Return the times of all cycles [us], but for those without one."""
    values = np.concatenate([getattr(run, f"{time}_us") for run in runs])
    return values[np.isfinite(values)]


def answer(summary: Mapping[str, Any], runs: Runs) -> Answer:
    """Make the first screen: who meets a period, what a miss does to the patient, and what the tail looks like."""
    table = Table(
        "Round trips over the wire, against the period", [_COLUMNS[key] for key in FIRST], case_rows(summary),
        "goal: met or missed where there is one (C at most 1 in 100,000 and Python 1 in 1,000 at 500 Hz, quiet, open "
        "where the 95 % interval holds that; under load no RCM error above "
        f"{1e3 * SAFE_RCM_M:g} mm and no stop that is not clean).",
    )  # fmt: skip
    rate = min(case.rate_Hz for case in runs)
    drawn = latency_ecdf(_of(runs, rate, "round"), 1e6 / rate, tail=True)
    says = f"Round trips at {rate} Hz, how many take as long: no line should reach the deadline."
    return marked_answer(sentences(summary), table, [Picture(drawn, says, f"round-{rate}")])


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """Say how many cycles missed on a quiet machine, what load does, and how many goals are reached."""
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
        missed, cycles, unclean = (sum(found[key] for found in loaded) for key in ("missed", "cycles", "unclean"))
        said.append(
            f"With every core busy {missed} of {cycles:,} were missed, the largest RCM error was "
            f"{max(found['rcm_max_mm'] for found in loaded):.2f} mm, and "
            f"{f'{unclean} stops were not clean' if unclean else 'every stop was clean'}."
        )
    return [*said, goals_in_words(summary["goals"])]


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


def _of(runs: Runs, rate: int, time: str) -> dict[str, Array]:
    return {f"{NAMES[c.controller]}, {c.load}": samples(found, time) for c, found in runs.items() if c.rate_Hz == rate}


def report(
    summary: Mapping[str, Any], goals: Mapping[str, Goal], runs: Runs, first: Answer, environment: Mapping[str, Any]
) -> Page:
    page = Page("Against the clock", "plant and controller as two processes with a UDP wire between them")
    first.begin(page)
    page.section("How to read this")
    page.text(
        "Wake-up latency: how late the plant's tick begins. Round trip: from the departure of a measurement to the "
        "arrival of its torque, over the loopback; a cycle is missed where that takes longer than the period. "
        "Controller: safety filter and control law alone. `environment` says which priority, memory and timers the two "
        "processes were granted; Python's collector is off inside both loops."
    )
    page.table(goal_table(summary["goals"], goals))
    page.section(DETAILS)
    page.table(Table(
        DETAILS, [_COLUMNS[key] for key in WHOLE], case_rows(summary),
        "Times: median / 99th / 99.99th percentile / worst.",
    ))  # fmt: skip
    for rate in sorted({case.rate_Hz for case in runs}):
        for time, title in TIMES.items():
            if (name := f"{time}-{rate}") not in page.figures:
                drawn = latency_ecdf(_of(runs, rate, time), 1e6 / rate if time == "round" else None, tail=True)
                page.figure(drawn, f"{title.capitalize()} at {rate} Hz: share of cycles that take as long.", name=name)
    page.environment(environment)
    return page


def page_text(summary: Mapping[str, Any], environment: Mapping[str, Any]) -> str:
    """Return the section of docs/realtime.md: the table of all cases, and the sentences of the first screen."""
    machine, config = environment["machine"], environment["config"]
    said = (
        f"`python -m benchmarks.realtime --cycles {config['cycles']} --page` ({machine['cores']} cores, "
        f"{machine['processor']}, seed {environment['seed']}). Times: median / 99th / 99.99th percentile / worst."
    )
    shown = markdown.of_columns([_COLUMNS[key] for key in WHOLE], case_rows(summary))
    return "\n\n".join([said, shown, " ".join(sentences(summary))])
