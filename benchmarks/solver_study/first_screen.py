"""The first screen of ``python -m benchmarks.solvers``: which solver to take, why, and which to avoid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from benchmarks.common.answer import Answer, Picture, interval_of, interval_picture
from benchmarks.solver_study.compare import LEAST_TRIALS
from benchmarks.solver_study.verdicts import AVOID, BEST_MU, GAPS, NEAR, OTHER, SOUND, TAKE, Row, assess
from moc_opt import figures
from moc_opt.comparison.statistics import spread
from moc_opt.comparison.trials import BASELINE
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import BAD, GOOD, MUTED, SERIES, WORST
from moc_opt.report.tables import Column, Table

CERTIFIED, RECORDED, CLOSED_LOOP = "Certified test sets", "Open loop on a recorded run", "Closed loop"
RULES = "How the verdicts are made"
LEGEND = "★ take, ✔ sound, ◐ gaps that it admits, ≈ near the optimum but never at it, ✘ avoid"
NONLINEAR_TOLD = (
    "; ≠ answers the nonlinear problem of the tick, about 1e-3 m/s off the linear one that the judge knows: right in "
    "its own way"
)
DAMAGE_TOLD = (
    "; worst damage: in closed loop, against the solver to take on the same trials (not DCAC); none: within what "
    "counts as equal"
)
COLORS = {mark: color for mark, color in zip(
    (TAKE, SOUND, GAPS, NEAR, OTHER, AVOID), (GOOD, GOOD, list(SERIES)[4], list(SERIES)[4], MUTED, WORST), strict=True,
)}  # fmt: skip


def answer(summary: Mapping[str, Any], deadline_us: float, *, drawn: bool = True) -> Answer:
    """Make the first screen out of the summary, as far as the study has come.

    Args:
        summary: of summary.json.
        deadline_us: of a tick.
        drawn: with pictures.
    """
    rows = assess(summary)
    return Answer(sentences(summary, rows), table(summary, rows), pictures(summary, rows, deadline_us) if drawn else ())


def table(summary: Mapping[str, Any], rows: Sequence[Row]) -> Table:
    """Return the one table: every solver under its recommended setting, the best first."""
    trials = max((row["trials"] or 0 for row in rows), default=0)
    counted = max((row["counted"].get("solves", 0) for row in rows), default=0)
    best = any(BEST_MU in row["closed"] for row in rows)
    where = CERTIFIED if "testsets" in summary else RECORDED
    recorded = RECORDED if "open_loop_warm" in summary else CERTIFIED
    loop = CLOSED_LOOP if trials else ""
    columns = [
        Column("solver", "solver"),
        Column("verdict", "verdict", section=RULES),
        Column("right_percent", "verified", unit="%", format=".2f", section=where,
               help=f"of {counted} certified problems: verified, or rightly called infeasible"),
        Column("silently_wrong", "silently wrong", format=".0f", section=where, help="claimed, but not optimal"),
        Column("p50_us", "p50", unit="us", format=".1f", section=recorded, help="median time of a warm solve"),
        Column("p99_us", "p99", unit="us", format=".1f", section=recorded, help="one solve in a hundred is slower"),
        Column("mu_percent", f"of {'best' if best else 'bound'}", unit="mu %", format=".1f", section=loop,
               help="mean manipulability over the "
               + ("best that can be executed" if best else "largest on the self-motion")),
        Column("damage", "worst damage", unit=f"{trials:.0f} trials" if trials else "", section=loop,
               help="in closed loop, against the solver to take: the figure that is worst beyond what counts as equal"),
    ]  # fmt: skip
    return Table(
        "Solvers under the settings we recommend, best first", columns, rows,
        LEGEND + (NONLINEAR_TOLD if any(row["verdict"] is OTHER for row in rows) else "")
        + (DAMAGE_TOLD if trials else ""),
    )


def sentences(summary: Mapping[str, Any], rows: Sequence[Row]) -> list[str]:
    """Say which solver to take and why, what else is sound and what it does to the robot, and what to avoid."""
    if not rows:
        return ["Nothing was run."]
    best = rows[0]
    if best["verdict"] is not TAKE:
        return ["No solver is sound on what was run; see the table.", *_avoid(summary, rows)]
    counted, kind = best["counted"], "certified" if "testsets" in summary else "recorded"
    said = [
        f"Take `{best['solver']}` ({_setting(summary, best['solver'])}): {counted['right']} of {counted['solves']} "
        f"{kind} problems answered rightly, none silently wrong, median {best['p50_us']:.1f} and p99 "
        f"{best['p99_us']:.1f} us."
    ]
    others = [row for row in rows if row["verdict"] is SOUND]
    parts = []
    if others:
        names = ", ".join(f"`{row['solver']}` ({row['p50_us']:.0f} us)" for row in others[:3])
        parts.append(f"sound as well: {names}")
    gain = spread(best["closed"], "mu_gain_percent", 2)
    if gain and best["trials"] >= LEAST_TRIALS:
        tip = spread(best["closed"], "tip_change_percent", 2)
        parts.append(
            f"in closed loop sound answers raise mean mu by {gain} % over `{BASELINE}` and the tip error by {tip} % "
            f"({best['trials']:.0f} trials)"
        )
    text = "; ".join(parts)
    return [*said, *([f"{text[0].upper()}{text[1:]}."] if text else []), *_avoid(summary, rows)]


def _setting(summary: Mapping[str, Any], solver: str) -> str:
    row = summary.get("settings", {}).get(f"{solver}@recommended", {})
    return str(row.get("reason") or "its recommended setting")


def _avoid(summary: Mapping[str, Any], rows: Sequence[Row]) -> list[str]:
    """Return what to avoid: solvers with the reason, and the settings that libraries come with."""
    parts = []
    for row in rows:
        if row["verdict"] is AVOID:
            wrong = row["silently_wrong"]
            hung = row["counted"].get("hung", 0) + row["counted"].get("crashed", 0)
            why = f"{wrong} silently wrong" if wrong else f"{hung} hung or crashed" if hung else str(row["damage"])
            parts.append(f"`{row['solver']}` ({why})")
    wrong = {
        name.removesuffix("@default"): m["silently_wrong"]
        for name, m in summary.get("testsets", {}).items()
        if name.endswith("@default") and m["silently_wrong"] and ":" not in name and not name.startswith("nlp-")
    }
    if wrong:
        listed = ", ".join(f"{name} {count}" for name, count in sorted(wrong.items(), key=lambda item: -item[1]))
        parts.append(f"any library on its own settings: success was claimed for wrong answers ({listed})")
    return [f"Avoid {', '.join(parts)}."] if parts else []


def pictures(summary: Mapping[str, Any], rows: Sequence[Row], deadline_us: float) -> list[Picture]:
    """Draw accuracy against time, the effect in closed loop, and times against the deadline."""
    found = []
    points = {
        row["solver"]: (row["p50_us"], row["relative_max"])
        for row in rows
        if row["verdict"] is not OTHER and row["p50_us"] and row["relative_max"] is not None
    }
    if points:
        where = "certified problem" if "testsets" in summary else "recorded problem"
        found.append(Picture(
            figures.accuracy_against_time(
                points, x_label="median time of a warm solve [us]", y_label=f"worst relative residual, any {where}",
                floor=1e-12,
            ),
            "To the lower left is better: " + _front(points), "accuracy-against-time",
        ))  # fmt: skip
    return [*found, *_closed_picture(rows), *_deadline_picture(rows, deadline_us)]


def _front(points: Mapping[str, tuple[float, float]]) -> str:
    front = figures.pareto({name: (time, max(error, 1e-12)) for name, (time, error) in points.items()})
    names = " and ".join([", ".join(front[:-1]), front[-1]] if len(front) > 1 else front)
    return f"nothing beats {names} in both."


def _closed_picture(rows: Sequence[Row]) -> list[Picture]:
    gains: dict[str, tuple[float, float, float]] = {}
    for row in rows:
        ends = interval_of(row["closed"], "mu_gain_percent")
        if ends is not None and not row["closed"].get("short_runs"):
            gains[row["solver"]] = ends
    if not gains:
        return []
    poor = [row["solver"] for row in rows if row["solver"] in gains and row["verdict"] is AVOID and
            str(row["damage"]).endswith("mu")]  # fmt: skip
    brief = [row["solver"] for row in rows if row["closed"].get("short_runs")]
    says = f"Gain of mean manipulability over `{BASELINE}` with its 95 % interval over the trials: " + (
        f"{', '.join(poor)} loses it, all others have the same." if poor else "all solvers have about the same."
    ) + (f" {', '.join(brief)} ran too short for it." if brief else "")
    drawn = interval_picture(gains, _tones(rows), "gain of mean mu [%]", {"no gain": 0.0})
    return [Picture(drawn, says, "closed-loop-effect")]


def _deadline_picture(rows: Sequence[Row], deadline_us: float) -> list[Picture]:
    ticks = {
        row["solver"]: tuple(row["closed"][f"tick_{p}_us"] for p in ("p50", "p99", "p99_9"))
        for row in rows
        if row["closed"].get("tick_p99_9_us")
    }
    if not ticks:
        return []
    late = [name for name, (_, _, tail) in ticks.items() if tail > deadline_us]
    says = "Median to 99.9th percentile of a whole tick in closed loop, the dot at p99: " + (
        f"{', '.join(late)} {'misses' if len(late) == 1 else 'miss'} the deadline of {deadline_us:g} us now and then."
        if late else f"all meet the deadline of {deadline_us:g} us."
    )  # fmt: skip
    drawn: go.Figure = interval_picture(
        ticks, _tones(rows), "time of a tick [us]", {"deadline": deadline_us}, log=True  # type: ignore[arg-type]
    )
    return [Picture(drawn, says, "deadlines")]


def _tones(rows: Sequence[Row]) -> dict[str, str]:
    """Return solver -> colour of its verdict."""
    colors: dict[Mark, str] = COLORS
    return {row["solver"]: colors.get(row["verdict"], BAD) for row in rows}
