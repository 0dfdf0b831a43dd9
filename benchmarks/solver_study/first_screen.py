"""The first screen of ``python -m benchmarks.solvers``: which solver to take, why, and which to avoid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from benchmarks.common.answer import Answer, Picture, interval_of, interval_picture
from benchmarks.solver_study.combine import COMPARED
from benchmarks.solver_study.study import NONLINEAR
from benchmarks.solver_study.tables import INCONSISTENT
from benchmarks.solver_study.verdicts import (
    AVOID,
    BEGINNING,
    BEST_MU,
    GAPS,
    NEAR,
    OTHER,
    SOUND,
    TAKE,
    Row,
    assess,
)
from moc_opt import figures
from moc_opt.figures.notation import Doubtful, Mark, Missing
from moc_opt.figures.style import BAD, GOOD, MUTED, SERIES, WORST
from moc_opt.report.tables import Column, Table
from moc_opt.study.statistics import LEAST_TRIALS, spread, too_few
from moc_opt.study.timing import load
from moc_opt.study.trials import BASELINE

CERTIFIED, RECORDED, CLOSED_LOOP = "Certified test sets", "Open loop on a recorded run", "Closed loop"
RULES = "How the verdicts are made"
LEGEND = (
    "★ take, ✔ sound, ◐ gaps: fails on some problems but reports it, ≈ near: close to the optimum, never within "
    "tolerance, ✘ avoid"
)
NONLINEAR_TOLD = (
    "; ≠ answers the nonlinear problem of the tick, about 1e-3 m/s off the linear one that the judge knows: right in "
    "its own way"
)
DAMAGE_TOLD = (
    "; tip, RCM: changes against DCAC on the same trials, ratio of the means, by the robot's own kinematics (what a "
    "controller can answer for) / in the frame registered at the start (what the patient gets), ?: undecided, as the "
    "mean of the ratios disagrees in sign or verdict; worst damage: surely, against {} on the trials "
    "that both ran (not DCAC); 'none' means within tolerance"
)
TIMED = ("open_loop_warm", "testsets", "growth", "closed_loop")
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
    drawings = pictures(summary, rows, deadline_us) if drawn else ()
    return Answer(sentences(summary, rows), table(summary, rows), drawings, load(timed_rows(summary)))


def timed_rows(summary: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the rows of the summary with times of solves and ticks, each measurement once."""
    return [row for part in TIMED for row in summary.get(part, {}).values()]


def table(summary: Mapping[str, Any], rows: Sequence[Row]) -> Table:
    """Return the one table: every solver under its recommended setting, the best first."""
    numbers = sorted({row["trials"] for row in rows if row["trials"]})
    trials = max(numbers, default=0)
    counted = max((row["counted"].get("solves", 0) for row in rows), default=0)
    best = any(BEST_MU in row["closed"] for row in rows)
    where = CERTIFIED if "testsets" in summary else RECORDED
    recorded = RECORDED if "open_loop_warm" in summary else CERTIFIED
    loop = CLOSED_LOOP if trials else ""
    taken = any(row["verdict"] is TAKE for row in rows)
    columns = [
        Column("solver", "solver"),
        Column("verdict", "verdict", section=RULES),
        Column("right_percent", "verified", unit="%", format=".2f", section=where,
               help=f"of {counted} certified problems without refused ones: verified, or rightly called infeasible"),
        Column("silently_wrong", "silently wrong", format=".0f", section=where, help="claimed, but not optimal"),
        Column("p50_us", "p50", unit="us", format=".1f", section=recorded, help="median time of a warm solve"),
        Column("p99_us", "p99", unit="us", format=".1f", section=recorded, help="one solve in a hundred is slower"),
        Column("tip_change", "tip own/ patient", unit="%", align="right", section=loop,
               help="change of the mean tip error against DCAC, in both frames; intervals: see closed loop"),
        Column("rcm_change", "RCM own/ patient", unit="%", align="right", section=loop,
               help="change of the mean RCM error against DCAC, in both frames"),
        Column("damage", "worst damage", section=loop,
               help="in closed loop, against the solver to take: the figure that is worst beyond what counts as equal"),
        Column("trials", "trials", format=".0f", section=loop, help="in closed loop, each with a seed of its own"),
        Column("mu_percent", f"of {'best' if best else 'bound'}", unit="mu %", format=".1f", section=loop,
               help="mean manipulability over the "
               + ("best that can be executed" if best else "largest on the self-motion")),
    ]  # fmt: skip
    if not trials:
        columns = columns[:6]
    return Table(
        "Solvers under the settings we recommend, best first", columns, [{**row, **_both_frames(row)} for row in rows],
        LEGEND + (NONLINEAR_TOLD if any(row["verdict"] is OTHER for row in rows) else "")
        + (DAMAGE_TOLD.format("the solver to take" if taken else "a sound solver") if trials else "")
        + (f"; refused: {INCONSISTENT}" if any(r["counted"].get("refused_inconsistent") for r in rows) else ""),
    )


def _both_frames(row: Row) -> dict[str, Any]:
    """Return the changes of tip and RCM in both frames as one text each; of too few trials, or of other ticks, none."""
    closed, found = row["closed"], {}
    if closed.get("short_runs"):
        return dict.fromkeys(("tip_change", "rcm_change"), Missing(BEGINNING))
    for name in ("tip", "rcm"):
        both = [f"{name}_{frame}change_percent" for frame in ("", "patient_")]
        if all(key in closed for key in both) and row["trials"] >= LEAST_TRIALS:
            marks = ("?" if closed.get(f"{key}_undecided") else "" for key in both)
            found[f"{name}_change"] = "/".join(f"{closed[key]:+.0f}{m}" for key, m in zip(both, marks, strict=True))
    return found


def sentences(summary: Mapping[str, Any], rows: Sequence[Row]) -> list[str]:
    """Say which solver to take and why, what else is sound and what it does to the robot, and what to avoid."""
    if not rows:
        return ["Nothing was run."]
    best = rows[0]
    if best["verdict"] is SOUND:
        names = ", ".join(f"`{row['solver']}`" for row in rows if row["verdict"] is SOUND)
        why = "was not timed" if best["p99_us"] is None else (
            "cannot be told: the machine was busy while times were taken; run again on a quiet machine"
        )
        return [f"Sound: {names}. Which of them is fastest {why}.", *_avoid(summary, rows)]
    if best["verdict"] is not TAKE:
        return ["No solver is sound on what was run; see the table.", *_avoid(summary, rows)]
    said = [
        f"Take `{best['solver']}` ({_setting(summary, best['solver'])}): {_answered(summary, best['counted'])}, none "
        f"silently wrong, median {best['p50_us']:.1f} and p99 {best['p99_us']:.1f} us."
        + (" The median decided: the machine was too busy to rank by p99." if best["ranked_by"] == "p50_us" else "")
    ]
    others = [row for row in rows if row["verdict"] is SOUND]
    parts = []
    if others:
        names = ", ".join(f"`{row['solver']}` ({row['p50_us']:.0f} us)" for row in others[:3])
        parts.append(f"sound as well: {names}")
    parts += _in_closed_loop(max([best, *others], key=lambda row: row["trials"] or 0))
    text = "; ".join(parts)
    return [*said, *([f"{text[0].upper()}{text[1:]}."] if text else []), *_avoid(summary, rows)]


def _answered(summary: Mapping[str, Any], counted: Mapping[str, Any]) -> str:
    """Count apart what was asked for: optima, infeasible problems, and inconsistent rows that were refused."""
    kind = "certified" if "testsets" in summary else "recorded"
    parts = [f"{counted['verified_solved']} of {counted['optima_asked']} {kind} optima verified"]
    if counted["infeasible_asked"]:
        parts.append(f"{counted['infeasible_right']} of {counted['infeasible_asked']} infeasible problems recognised")
    if counted["refused_inconsistent"]:
        parts.append(
            f"{counted['refused_inconsistent']} of {counted['inconsistent_asked']} with inconsistent rows refused"
        )
    return ", ".join(parts)


def _in_closed_loop(row: Row) -> list[str]:
    """Say what a sound solver's answers do to the robot, with the errors in both frames."""
    trials, closed = row["trials"], row["closed"]
    if not trials or closed.get("short_runs") or not all(name in closed for name in COMPARED.values()):
        return []
    if few := too_few(trials):
        return [f"what sound answers do in closed loop: {few}"]
    said = {name: spread(closed, name, 2, "+", " %") for name in COMPARED.values()}
    return [
        f"in closed loop ({trials} independent trials of `{row['solver']}`, ratio of the means) sound answers change "
        f"mean mu by {said['mu_gain_percent']} over `{BASELINE}`, the tip error by {said['tip_change_percent']} by the "
        f"robot's own kinematics and by {said['tip_patient_change_percent']} in the frame registered at the start, "
        f"which is the patient's, and the RCM error by {said['rcm_change_percent']} and "
        f"{said['rcm_patient_change_percent']}"
    ]


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
    plain = {
        name.removesuffix("@default"): m["silently_wrong"]
        for name, m in summary.get("testsets", {}).items()
        if name.endswith("@default") and not name.startswith(NONLINEAR)
    }
    wrong = sorted((name for name in plain if plain[name]), key=lambda name: -plain[name])
    if wrong:
        listed = ", ".join(f"`{name}` {plain[name]}" for name in wrong)
        parts.append(
            "the libraries' own defaults on the paper's six dependent rows with the cost unscaled: "
            f"{len(wrong)} of {len(plain)} solvers claimed success for wrong answers ({listed})"
        )
    return [f"Avoid {', '.join(parts)}."] if parts else []


def pictures(summary: Mapping[str, Any], rows: Sequence[Row], deadline_us: float) -> list[Picture]:
    """Draw accuracy against time, the effect in closed loop, and times against the deadline."""
    found = []
    points = {
        row["solver"]: (row["p50_us"], row["relative_max"])
        for row in rows
        if row["verdict"] is not OTHER and row["p50_us"] and row["relative_max"] is not None
        and not isinstance(row["p50_us"], Doubtful)
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
    numbers = [row["trials"] for row in rows if row["solver"] in gains]
    poor = [row["solver"] for row in rows if row["solver"] in gains and str(row["damage"]).endswith("% mu")]
    brief = [row["solver"] for row in rows if row["closed"].get("short_runs")]
    says = f"Gain of mean manipulability over `{BASELINE}` with its 95 % interval over a solver's trials: " + (
        too_few(max(numbers)) or (f"{', '.join(poor)} surely lost some." if poor else "none surely lost some.")
    ) + (f" {', '.join(brief)} ran too short for it." if brief else "")
    drawn = interval_picture(gains, _tones(rows), "gain of mean mu [%]", {"no gain": 0.0})
    return [Picture(drawn, says, "closed-loop-effect")]


def _deadline_picture(rows: Sequence[Row], deadline_us: float) -> list[Picture]:
    tails = {row["solver"]: row["closed"]["tick_p99_9_us"] for row in rows if row["closed"].get("tick_p99_9_us")}
    if not tails:
        return []
    ticks = {
        row["solver"]: tuple(float(row["closed"][f"tick_{p}_us"]) for p in ("p50", "p99", "p99_9"))
        for row in rows
        if row["solver"] in tails
    }
    over = {name: tail for name, tail in tails.items() if tail > deadline_us}
    late = [name for name, tail in over.items() if not isinstance(tail, Doubtful)]
    unknown = [name for name in over if name not in late]
    says = "Median to 99.9th percentile of a whole tick in closed loop, the dot at p99: " + (
        f"{', '.join(late)} {'misses' if len(late) == 1 else 'miss'} the deadline of {deadline_us:g} us now and then."
        if late else f"all {'others ' if unknown else ''}meet the deadline of {deadline_us:g} us."
    ) + (f" Of {', '.join(unknown)} it cannot be told: the machine was busy." if unknown else "")  # fmt: skip
    drawn: go.Figure = interval_picture(
        ticks, _tones(rows), "time of a tick [us]", {"deadline": deadline_us}, log=True  # type: ignore[arg-type]
    )
    return [Picture(drawn, says, "deadlines")]


def _tones(rows: Sequence[Row]) -> dict[str, str]:
    """Return solver -> colour of its verdict."""
    colors: dict[Mark, str] = COLORS
    return {row["solver"]: colors.get(row["verdict"], BAD) for row in rows}
