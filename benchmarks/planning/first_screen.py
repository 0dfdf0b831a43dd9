"""The first screen of ``python -m benchmarks.plan``: how far each third level ends below the best course, and where."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.common.answer import NO, UNKNOWN, YES, Answer, Picture, interval_of, interval_picture
from benchmarks.planning.goals import MOST_CHANGE_PERCENT, MOST_GAP_PERCENT
from benchmarks.planning.parts import ERRORS
from moc_opt.comparison.statistics import StatisticsError, mean
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import GOOD, SERIES, Styles, figure, label, log_axis, rule
from moc_opt.report.tables import Column, Table

Rows = Sequence[Mapping[str, Any]]

TRAPPED_PERCENT = 5.0
"""A run that ends further below the best course from its start is trapped: as a rule at a lower local maximum of mu."""
MORE = f"more than {TRAPPED_PERCENT:g} % below"
LOCAL = "local"
IN_THE_LOOP, COURSES = "In the loop", "Courses and checks"
LEAST_PERCENT = 0.01
"""Where a gap that is smaller, or none, is drawn on the log axis."""


def answer(summary: Mapping[str, Any], rows: Rows) -> Answer:
    """Make the first screen out of the rows and their summary."""
    runs = [row for row in rows if row["part"] == "loop" and not row["error"]]
    if not runs:
        return Answer(["No run came to its end: see the errors below."], _table(summary))
    return Answer(list(_sentences(summary, runs)), _table(summary), list(_pictures(summary, runs)))


def _sentences(summary: Mapping[str, Any], runs: Rows) -> Iterator[str]:
    """Say what each third level leaves, where the local one is trapped and by how much, and which goals are met."""
    names = list(dict.fromkeys(row["loop"] for row in runs))
    gaps = {name: [row["gap_percent"] for row in runs if row["loop"] == name] for name in names}
    said = [f"`{name}` {_mean(mine)} % ({max(mine):.1f} at worst, {len(mine)} runs)" for name, mine in gaps.items()]
    yield f"In the loop mean mu ends below that of the best course from the same start by: {', '.join(said)}."
    local = sorted((row for row in runs if row["loop"] == LOCAL), key=lambda row: -float(row["gap_percent"]))
    trapped = [row for row in local if row["gap_percent"] > TRAPPED_PERCENT]
    free = [row["gap_percent"] for row in local if row["gap_percent"] <= TRAPPED_PERCENT]
    if trapped:
        where = ", ".join(f"{row['robot']} {row['trial']} ({row['gap_percent']:.0f} %)" for row in trapped[:4])
        more = f" and {len(trapped) - 4} more" if len(trapped) > 4 else ""
        text = f"Climbing mu locally is trapped ({MORE}) at {len(trapped)} of {len(local)} starts: {where}{more}"
        yield text + (f"; elsewhere it leaves {_mean(free)} %." if free else ".")
    elif local:
        yield f"Climbing mu locally is trapped ({MORE}) at none of {len(local)} starts."
    verdicts = [goal["verdict"] for goal in summary["goals"]]
    missed = [f"{goal['robot']}: {goal['goal']} {goal['value']}" for goal in summary["goals"]
              if goal["verdict"] == "missed"]  # fmt: skip
    text = f"{verdicts.count('met')} of {len(verdicts)} goals are met, {verdicts.count('open')} open"
    more = f" and {len(missed) - 3} more" if len(missed) > 3 else ""
    yield text + (f"; missed: {'; '.join(missed[:3])}{more}." if missed else ".")


def _mean(values: Sequence[float]) -> str:
    """Return the mean with its interval, where there are two values and more."""
    try:
        found = mean(values)
    except StatisticsError:
        return "–"
    return f"{found.value:.2f}" if found.low != found.low else f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}]"


def _table(summary: Mapping[str, Any]) -> Table:
    """Return one row a robot and third level: its gap and what it costs, against the goals."""
    rows = []
    for robot, by in summary["loops"].items():
        for name, found in by.items():
            rows.append({
                "robot": robot, "loop": name, "runs": found["runs"] - found["broken"],
                "gap": _mark(found, "gap_percent", MOST_GAP_PERCENT.get(name), ".2f"),
                "worst": found.get("gap_percent_max"), "over": found.get("gap_over_5"),
                **{short: _mark(found, f"{key}_change_percent", MOST_CHANGE_PERCENT, "+.1f")
                   for short, key in zip(("tip", "rcm"), ERRORS, strict=True) if name != LOCAL},
            })  # fmt: skip
    columns = [
        Column("robot", "robot", section=COURSES),
        Column("loop", "third level"),
        Column("runs", "runs", format="d", help="that came to their end"),
        Column("gap", "below best", unit="%", section=IN_THE_LOOP,
               help="mean mu below that of the best course from the same start"),
        Column("worst", "worst", unit="%", format=".1f", section=IN_THE_LOOP),
        Column("over", "trapped", format="d", section=IN_THE_LOOP, help=f"runs more than {TRAPPED_PERCENT:g} % below"),
        Column("tip", "tip", unit="%", section=IN_THE_LOOP, help="change of the error against local's"),
        Column("rcm", "RCM", unit="%", section=IN_THE_LOOP, help="change of the error against local's"),
    ]  # fmt: skip
    return Table(
        "How far each third level ends below the best course", columns, rows,
        "✔ the goal is met by the unfavourable end of the interval, ✘ missed by all of it, – open.",
    )  # fmt: skip


def _mark(found: Mapping[str, Any], name: str, limit: float | None, spec: str) -> Mark | None:
    """Mark the figure by whether both ends of its interval lie on one side of the limit; None: not measured."""
    value, low, high = (found.get(f"{name}{end}") for end in ("", "_low", "_high"))
    if value is None:
        return None
    known = UNKNOWN
    if limit is not None and low is not None and high is not None:
        known = YES if high <= limit else NO if low > limit else UNKNOWN
    return Mark(known.symbol, format(value, spec), known.tone, known.rank)


def _pictures(summary: Mapping[str, Any], runs: Rows) -> Iterator[Picture]:
    """Draw the gap of every run, the mean gaps with their intervals, and what they cost in tip and RCM error."""
    names = list(dict.fromkeys(row["loop"] for row in runs))
    starts: dict[tuple[str, str], dict[str, float]] = {}
    for row in runs:
        starts.setdefault((row["robot"], row["trial"]), {})[row["loop"]] = row["gap_percent"]
    order = sorted(starts, key=lambda key: -starts[key].get(LOCAL, 0.0))
    drawn, styles = figure(legend_y=1.08, height=340), Styles(names)
    for name in names:
        known = [(place, key, starts[key][name]) for place, key in enumerate(order, 1) if name in starts[key]]
        drawn.add_scatter(
            x=[place for place, *_ in known], y=[max(gap, LEAST_PERCENT) for *_, gap in known], mode="markers",
            name=label(name), customdata=[label(f"{robot} {trial}: {gap:.2f} %") for _, (robot, trial), gap in known],
            marker={"color": styles[name].color, "symbol": styles[name].symbol, "size": 7},
            hovertemplate="%{customdata}<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    log_axis(drawn, "y", "below the best course [%]", [LEAST_PERCENT, max(row["gap_percent"] for row in runs)])
    rule(drawn, "y", TRAPPED_PERCENT, "trapped")
    drawn.update_xaxes(title_text="start, by what the local law leaves there")
    count = sum(by.get(LOCAL, 0.0) > TRAPPED_PERCENT for by in starts.values())
    yield Picture(drawn, f"Every run, the starts that are worst for `{LOCAL}` first: it is trapped at {count} of "
                  f"{len(starts)}, where the others should lie far below it.", "gaps")  # fmt: skip
    for key, x_label, says, words in (
        ("gap_percent", "below the best course [%]",
         "Mean gap with its 95 % interval: further left is closer to the best that can be executed from that start.",
         "mean-gaps"),
        (f"{ERRORS[1]}_change_percent", "change of the RCM error [%]",
         f"What it costs: change of the RCM error against `{LOCAL}`, the goal at most {MOST_CHANGE_PERCENT:g} %.",
         "rcm-cost"),
    ):  # fmt: skip
        intervals, tones = {}, {}
        for robot, by in summary["loops"].items():
            for name, found in by.items():
                if (ends := interval_of(found, key)) is not None:
                    intervals[f"{robot}, {name}"] = ends
                    tones[f"{robot}, {name}"] = GOOD if name != LOCAL else list(SERIES)[1]
        if intervals:
            limits = {"none": 0.0} if key == "gap_percent" else {"goal": MOST_CHANGE_PERCENT}
            yield Picture(interval_picture(intervals, tones, x_label, limits), says, words)
