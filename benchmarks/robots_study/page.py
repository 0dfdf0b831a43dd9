"""What the study of the arms shows: the first screen, and folded below it the tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.common.answer import NO, UNKNOWN, YES, Answer, Picture, interval_of, interval_picture
from benchmarks.common.output import close_page
from benchmarks.paper_experiment.verdict import ABOUT_FRAMES
from benchmarks.robots_study.runs import SETTLED
from benchmarks.robots_study.verdict import (
    ERRORS,
    FINDINGS,
    JUDGED,
    LEAST_GAIN_PERCENT,
    MOST_CHANGE_PERCENT,
    Rows,
    few,
    judged,
    sentences,
)
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import BAD, GOOD, WORST
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

RESULTS, FOUND = "Results", "Which findings hold where"
TITLES = ("tip, own", "registered", "base", "RCM, own", "registered", "base")
"""Of `ERRORS`."""
FIRST = [
    Column("robot", "arm", section=RESULTS),
    Column("gains", "mu", unit="%", section=FOUND, help=f"gain of the mean; ✔ {FINDINGS['gains']}"),
    *(Column(key, title, unit="%", section=RESULTS, help=f"change, settled; ✔ {FINDINGS[key]}")
      for key, title in zip(ERRORS, TITLES, strict=True)),
]  # fmt: skip
BY_ARM = [
    Column("robot", "arm"), Column("controller", "controller"), Column("trials", "trials", format="d"),
    Column("broken", "broke off", format="d"), Column("mu_gain_percent", "gain in mu", unit="%", format="+.1f"),
    Column("mu_fraction_of_bound", "of bound", format=".3f"), Column("mu_bound_method", "best of"),
    Column("mu_fraction_of_best_from_start", "of best from start", format=".3f", help="of the best course from there"),
    Column("mu_fraction_of_best", "of best", format=".3f", help="of the best course from any swivel and branch"),
    *(Column(f"{key}_change_percent", title, unit="%", format="+.1f", help="change, settled")
      for key, title in zip(ERRORS, TITLES, strict=True)),
    Column("tip_model_much_worse", "tip, own > 10 % worse", format="d"),
    Column("tip_much_worse", "tip, base > 10 % worse", format="d"),
    *(Column(name, title, unit="mm", format=".3f") for name, title in zip(SETTLED, TITLES, strict=True)),
    Column("trocar_force_mean_N", "force", unit="N", format=".2f"),
    Column("infeasible_ticks", "infeasible ticks", format=".0f"),
]  # fmt: skip
ASKED = {
    "gains": ("gain of mean mu [%]", {"no gain": 0.0, "goal": LEAST_GAIN_PERCENT}, "right of"),
    "tip_registered": ("change of the settled tip error, registered [%]", {"goal": MOST_CHANGE_PERCENT}, "left of"),
    "rcm": ("change of the settled RCM error, registered [%]", {"goal": MOST_CHANGE_PERCENT}, "left of"),
}
"""Finding that is drawn -> axis, lines, and the side of the goal that is good."""


def answer(summary: Mapping[str, Any]) -> Answer:
    """Make the first screen: one row an arm, for `exact` or the first solver there is."""
    rows = []
    for arm, figures in summary["robots"].items():
        holds, broken = summary["findings"][arm], sum(other["broken"] for other in figures.values())
        cells = {key: _mark(holds[key], judged(figures).get(change)) for key, change in JUDGED.items()}
        rows.append({"robot": f"{arm}; {broken} broke off" if broken else arm, **cells})
    about = "✔ the finding holds by the mean, ✘ it does not, – open. Broke off: runs of all controllers."
    table = Table("Every arm against DCAC with the same gains", FIRST, rows, about)
    return Answer(sentences(summary), table, list(_pictures(summary)))


def _mark(holds: bool | None, percent: float | None) -> Mark:
    known = UNKNOWN if holds is None else YES if holds else NO
    text = "open" if percent is None else f"{percent:+.1f}" if abs(percent) < 9.95 else f"{percent:+.0f}"
    return Mark(known.symbol, text, known.tone, known.rank)


def _pictures(summary: Mapping[str, Any]) -> Iterator[Picture]:
    """Draw gain, tip and RCM error of every arm with their intervals, coloured by whether the finding holds."""
    for key, (x_label, limits, side) in ASKED.items():
        found = {arm: interval_of(judged(by), JUDGED[key]) for arm, by in summary["robots"].items()}
        intervals = {arm: ends for arm, ends in found.items() if ends is not None}
        held = {arm: summary["findings"][arm][key] for arm in intervals}
        if intervals:
            tones = {arm: BAD if holds is None else GOOD if holds else WORST for arm, holds in held.items()}
            says = (
                f"Change over DCAC with its 95 % interval over the trials: {sum(map(bool, held.values()))} of "
                f"{len(held)} arms lie {side} the goal by their mean."
            )
            drawn = interval_picture(intervals, tones, x_label, limits)
            yield Picture(drawn, says, f"arms-{key.partition('_')[0]}")


def report(summary: Mapping[str, Any], rows: Rows, first: Answer, environment: Mapping[str, Any]) -> Page:
    """Make the page out of the rows, their summary and its first screen."""
    page = Page("The arms", "what of the study holds on every arm, and what is the LWR4+'s")
    first.begin(page)
    page.section("How to read this")
    page.text(
        "Every arm does the paper's three tasks from random poses of its own workspace, in the realistic plant at the "
        "default preset; DCAC has the same gains and trials. Settled errors are those at ticks at which no elbow is on "
        "its way. Intervals in summary.json are 95 %, over trials. A run that broke off is counted and in no mean. "
        "The error of the registered frame grows with the distance from the pose at which the arm touched task and "
        "trocar, where DCAC stays, and which the third level leaves."
    )
    page.section(RESULTS)
    arms, findings, ranking = summary["robots"], summary["findings"], summary["ranking"]
    shown = [{"robot": arm, "controller": name, **row} for arm, by in arms.items() for name, row in by.items()]
    page.table(Table("Changes against DCAC with the same gains", BY_ARM, shown, ABOUT_FRAMES))
    page.section(FOUND)
    word = {True: "yes", False: "no", None: "open"}
    holds = [{"finding": said} | {arm: word[by[key]] for arm, by in findings.items()} for key, said in FINDINGS.items()]
    lacking = "; ".join(f"{arm}: {words}" for arm, by in arms.items() if (words := few(by)))
    columns = [Column("finding", "finding"), *(Column(arm, arm) for arm in findings)]
    page.table(Table("Which findings hold on which arm", columns, holds, lacking))
    page.section("Solvers")
    order = [{"robot": arm, "order": ", ".join(names)} for arm, names in ranking["order"].items()]
    page.table(Table("Solvers by mean mu, best first", [Column("robot", "arm"), Column("order", "order")], order))
    close_page(page, "robots", environment, rows, ("robot", "trial", "controller"))
    return page
