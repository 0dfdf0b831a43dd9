"""A verdict on each solver, and the first screen of the report. docs/solvers.md explains the rules."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from moc_opt import figures
from moc_opt.figures.comparisons import FLOOR
from moc_opt.figures.notation import Mark, Missing
from moc_opt.figures.style import BAD, GOOD, MUTED, SERIES, WORST
from moc_opt.report.run_table import listed
from moc_opt.report.tables import Column, Table
from moc_opt.study.results import Results, change_name
from moc_opt.study.show import Picture, ends, intervals_picture
from moc_opt.study.solver_answers import RIGHTLY, share_right
from moc_opt.study.solver_settings import DEFAULT, NONLINEAR, QPSOLVERS, RECOMMENDED, of
from moc_opt.study.statistics import LEAST_TRIALS, Change, spread, too_few
from moc_opt.study.timing import quiet
from moc_opt.study.trials import BASELINE

Summary = Mapping[str, Any]
Row = dict[str, Any]

TAKE, SOUND = Mark("★", "take", "best", 0), Mark("✔", "sound", "good", 1)
GAPS, NEAR = Mark("◐", "gaps", "fair", 2), Mark("≈", "near", "fair", 3)
OTHER, OPEN = Mark("≠", "other", "other", 4), Mark("–", "open", "other", 5)
AVOID = Mark("✘", "avoid", "bad", 6)
TONES = {TAKE: GOOD, SOUND: GOOD, GAPS: list(SERIES)[4], NEAR: list(SERIES)[4], OTHER: MUTED, OPEN: BAD, AVOID: WORST}
# In closed loop, a mean may be worse than with the best solver. This change has two 95 % intervals (see `Change` in
# moc_opt.study.statistics). The loss is sure if both lie beyond the mean's tolerance in `COSTS`.
TOO_MUCH = 5.0  # [tolerances] with a larger sure loss, a solver gets the verdict AVOID
COSTS = {
    "mu_mean": ("mu", 0.01),
    "tip_error_model_mean_mm": ("tip", 0.05), "tip_error_registered_mean_mm": ("registered tip", 0.05),
    "rcm_error_model_mean_mm": ("RCM", 0.05), "rcm_error_registered_mean_mm": ("registered RCM", 0.05),
    "torque_rate_rms_Nm_per_s": ("chatter", 0.1),
}  # fmt: skip
"""Short name and tolerance of each mean. The tolerance is the share by which a mean may be worse at no cost."""
FRAMED = tuple(name for name in COSTS if "_error_" in name)
CERTIFIED, RECORDED, CLOSED = "Certified test sets", "Recorded sequence", "Closed loop"
INCONSISTENT = (
    "Inconsistent: the six equality rows contradict each other along the shaft, by 1e-12 to 1e-4 m/s. With only five "
    "independent rows, the problem has a certified optimum. For the problem with all six rows, the answer "
    "'infeasible' is true but useless. It is counted neither as right nor as wrong."
)


def assess(summary: Summary, runs: Results) -> list[Row]:
    """Return one row per solver under its recommended setting, the best first.

    If a library ran both through qpsolvers and through its own adapter, only the adapter is rated.
    """
    sets, warm, closed = (summary.get(part, {}) for part in ("testsets", "open_loop_warm", "closed_loop"))
    certified = {n.removesuffix(f"@{RECOMMENDED}"): m for n, m in sets.items() if n.endswith(f"@{RECOMMENDED}")}
    every = dict.fromkeys([*certified, *warm, *(n for n in closed if n != BASELINE)])
    names = [n for n in every if n.removeprefix(QPSOLVERS) == n or n.removeprefix(QPSOLVERS) not in every]
    rows = [_figures(n, certified.get(n, {}), warm.get(n, {}), closed.get(n, {})) for n in names]
    for row in rows:
        row["verdict"] = verdict(row)
    ran = [row for row in rows if row["closed"].get("whole") and row["verdict"] is not OTHER]
    reference = min(ran, key=_order, default={"solver": None})["solver"]
    shared = runs.shared()
    for row in rows:
        row["damage"], size = _damage(row, reference, runs)
        row["verdict"] = verdict(row, size)
        row["tip_change"] = _tip_in_both_frames(shared, row["solver"])
    sound = [row for row in rows if row["verdict"] is SOUND]
    timed = [row for row in sound if row["p99_us"] is not None]
    if timed or len(sound) == 1:
        min(timed or sound, key=_order)["verdict"] = TAKE
    return sorted(rows, key=_order)


def verdict(row: Row, damage: float = 0.0) -> Mark:
    """Return the first verdict whose rule holds. ``damage`` is the worst sure loss in closed loop, in tolerances."""
    counted = row["counted"]
    broken = counted.get("hung", 0) + counted.get("crashed", 0) + sum(_ended(row["closed"]).values())
    rules = {
        OTHER: row["solver"].startswith(NONLINEAR),
        AVOID: row["silently_wrong"] or broken or damage > TOO_MUCH,
        OPEN: not counted.get("solves"),
        NEAR: not counted.get("claimed_solved") or damage > 1.0,
        GAPS: share_right(counted) < RIGHTLY,
    }
    return next((mark for mark, holds in rules.items() if holds), SOUND)


def _figures(name: str, certified: Row, warm: Row, closed: Row) -> Row:
    counted = certified or warm
    other = name.startswith(NONLINEAR)
    hidden = Missing("it solves a nonlinear version of the problem: not comparable")
    wrong = sum(int(part.get("silently_wrong") or 0) for part in (certified, warm, closed))
    timed, suffix = (warm, "") if warm.get("solve_p50_us") is not None else (certified, "_worst_set")
    share = math.floor(1e4 * share_right(counted)) / 100.0 if counted.get("solves") else None  # never rounded to 100
    return {
        "solver": name, "counted": counted, "closed": closed, "relative_max": counted.get("relative_max"),
        "right_percent": hidden if other else share, "silently_wrong": hidden if other else wrong,
        "p50_us": timed.get(f"solve_p50_us{suffix}"), "p99_us": timed.get(f"solve_p99_us{suffix}"),
        "quiet": quiet(timed), "trials": closed.get("compared", 0),
    }  # fmt: skip


def _ended(closed: Row) -> dict[str, int]:
    """Count the runs that broke off or oscillated in the trials that every solver ran."""
    return {word: closed.get(f"{word.replace(' ', '_')}_in_common", 0) for word in ("broke off", "oscillated")}


def _order(row: Row) -> tuple[float, float, float]:
    gaps = -row["right_percent"] if row["verdict"] is GAPS else 0.0
    return row["verdict"].rank, gaps, math.inf if row["p99_us"] is None else row["p99_us"]


def _damage(row: Row, reference: str | None, runs: Results) -> tuple[Any, float]:
    """Return the worst loss as text, and its size in tolerances if it is sure, else 0."""
    for word, count in _ended(row["closed"]).items():
        if count:
            return f"{count} {word}", TOO_MUCH
    if reference is None or not row["closed"].get("whole"):
        return Missing("not run in closed loop"), 0.0
    changes = {metric: runs.change(metric, row["solver"], reference) for metric in COSTS}
    known = {metric: change for metric, change in changes.items() if change is not None}
    if not known:
        return Missing("no completed trial in common with the best solver"), 0.0
    if few := too_few(min(change.ratio.samples for change in known.values())):
        return Missing(few), 0.0
    sizes = {metric: _size(metric, change) for metric, change in known.items()}
    surely, perhaps = (max(sizes, key=lambda metric: sizes[metric][end]) for end in (0, 1))
    if sizes[surely][0] > 1.0:
        return f"{known[surely].ratio.value:+.0f}% {COSTS[surely][0]}", sizes[surely][0]
    return (f"undecided: {COSTS[perhaps][0]}" if sizes[perhaps][1] > 1.0 else "none"), 0.0


def _size(metric: str, change: Change) -> tuple[float, float]:
    """Return the smallest and the largest loss in the two intervals of a change, in tolerances."""
    sides = [(-one.high, -one.low) if metric == "mu_mean" else (one.low, one.high) for one in change]
    equal = 100.0 * COSTS[metric][1]
    return min(low for low, _ in sides) / equal, max(high for _, high in sides) / equal


# --- in words ---


def sentences(summary: Summary, rows: Sequence[Row]) -> list[str]:
    """Say which solvers to use and to avoid."""
    if not rows:
        return ["Nothing was run."]
    best, sound = rows[0], [row for row in rows if row["verdict"] is SOUND]
    if best["verdict"] is SOUND:
        names = ", ".join(f"`{row['solver']}`" for row in sound)
        said = [f"Sound: {names}. Which of these is fastest is unknown: they were not timed."]
    elif best["verdict"] is TAKE:
        known = summary.get("settings", {}).get(f"{best['solver']}@{RECOMMENDED}", {})
        reason = known.get("reason") or "its recommended setting"
        said = [f"Use `{best['solver']}` ({reason}){_why(summary, best, sound, len(rows))}"]
    elif "testsets" not in summary and "open_loop_warm" not in summary:
        said = ["Which solver is sound is unknown: the certified sets were not run."]
    else:
        said = ["No solver is sound in the parts that were run; see the table."]
    if best["verdict"] is TAKE and sound:
        medians = ["" if row["p50_us"] is None else f" ({row['p50_us']:.0f} us)" for row in sound[:3]]
        names = ", ".join(f"`{row['solver']}`{median}" for row, median in zip(sound[:3], medians, strict=True))
        said[0] += f" Also sound: {names}."
    if ran := [row for row in rows if row["verdict"] in (TAKE, SOUND) and row["trials"]]:
        said.append(_in_closed_loop(max(ran, key=lambda row: row["trials"]), _trials(rows)[0]))
    return said + _avoid(summary, rows)


def _why(summary: Summary, row: Row, others: Sequence[Row], asked: int) -> str:
    counted = row["counted"]
    kind = "certified" if "testsets" in summary else "recorded"
    parts = [f"found {counted['verified_solved']} of {counted['optima_asked']} {kind} optima"]
    if counted["infeasible_asked"]:
        parts.append(f"recognised {counted['infeasible_right']} of {counted['infeasible_asked']} infeasible problems")
    text = "" if others or asked == 1 else f", the only sound one of {asked} solvers"
    text += f". It {listed(parts)}; none of its answers was silently wrong."
    if refused := counted["refused_inconsistent"]:
        text += f" It refused {refused} more problems as infeasible: their velocities of tip and wrist contradict each "
        text += "other along the rigid tool. These count neither as right nor as wrong."
    if row["p50_us"] is not None:
        text += f" Its median solve time is {row['p50_us']:.1f} us, p99 {row['p99_us']:.1f} us."
        # Noise may exchange the order of this solver and of those whose median is at most its p99.
        close = [one for one in (row, *others) if (one["p50_us"] or 0.0) <= row["p99_us"]]
        if not all(one["quiet"] for one in close):
            text += " But other programs used the machine while this or an equally fast solver was timed: run again."
    return text


def _in_closed_loop(row: Row, shared: int) -> str:
    closed, trials = row["closed"], row["trials"]
    if few := too_few(trials):
        return f"The effect of sound answers in closed loop is unknown: {few}."
    names = ("mu_mean", *(name for name in FRAMED if "registered" in name))
    mu, tip, rcm = (spread(closed, change_name(name), 2, "+", " %") for name in names)
    shaken = f"; {count} of them oscillated" if (count := closed.get("oscillated", 0)) else ""
    common = ""
    if row["tip_change"] and shared < trials:
        shaken += f" ({closed.get('oscillated_in_common', 0) or 'none'} of the first {shared})" if shaken else ""
        model, registered = row["tip_change"].split("/")
        common = f" In the first {shared} trials, which the other solvers ran too, the registered tip error changes by "
        common += f"{registered} %, and the tip error computed with the robot's kinematic model by {model} %."
    return (
        f"In closed loop, `{row['solver']}` ran {trials} independent trials{shaken}. Relative to `{BASELINE}`, mean mu "
        f"changes by {mu}. In the frame registered at the start, the tip error changes by {tip} and the RCM error by "
        f"{rcm}.{common}"
    )


def _avoid(summary: Summary, rows: Sequence[Row]) -> list[str]:
    parts, shared = [], min(_trials(rows), default=0)
    for row in rows:
        if row["verdict"] is AVOID:
            wrong = row["silently_wrong"]
            gone = row["counted"].get("hung", 0) + row["counted"].get("crashed", 0)
            badly = [f"{n} of {shared} runs {word}" for word, n in _ended(row["closed"]).items() if n]
            loss = badly[0] if badly else str(row["damage"])
            why = f"{wrong} silently wrong" if wrong else f"{gone} hung or crashed" if gone else loss
            parts.append(f"`{row['solver']}` ({why})")
    ending = f"@{DEFAULT}"
    plain = {
        name.removesuffix(ending): m["silently_wrong"] for name, m in summary.get("testsets", {}).items()
        if name.endswith(ending) and of(name.removesuffix(ending))[DEFAULT][0].get("rows") == 6
    }  # fmt: skip
    said = [f"Avoid {'; '.join(parts)}."] if parts else []
    if wrong := [name for name in plain if plain[name]]:
        listed = ", ".join(f"`{name}` {plain[name]}" for name in sorted(plain, key=lambda name: -plain[name]))
        said.append(
            f"{'Also avoid' if parts else 'Avoid'} a library's default settings with the paper's six dependent rows "
            f"and an unscaled cost. With these, {len(wrong)} of {len(plain)} libraries claimed success for wrong "
            f"answers (counts: {listed})."
        )
    return [" ".join(said)] if said else []


# --- the first screen ---


def first_table(summary: Summary, rows: Sequence[Row]) -> Table:
    """Return the table of the first screen."""
    kind = CERTIFIED if "testsets" in summary else RECORDED
    recorded = RECORDED if "open_loop_warm" in summary else CERTIFIED
    columns = [
        Column("solver", "solver"), Column("verdict", "verdict"),
        Column("right_percent", "right", unit="%", format=".2f", section=kind,
               help="verified, or rightly called infeasible; without refused inconsistent problems"),
        Column("silently_wrong", "wrong", format=".0f", section=kind, help="claimed as solved, but not optimal"),
        Column("p50_us", "p50", unit="us", section=recorded, help="median time of a warm solve"),
        Column("p99_us", "p99", unit="us", section=recorded, help="one solve in a hundred is slower"),
    ]  # fmt: skip
    said = [
        "★ take: the sound solver with the smallest p99. ✔ sound: no other verdict applies. ◐ gaps: less than "
        f"{100 * RIGHTLY:g} % right, but never silently wrong. ≠ other: it solves a nonlinear version of the problem, "
        "so its answers are not judged.",
        "≈ near: it never calls an answer optimal, or a mean in closed loop is surely worse than with ★ by more than "
        "its tolerance. Surely: the 95 % intervals of both estimates of the change lie beyond the tolerance.",
        "✘ avoid: it was silently wrong, hung or crashed; or one of its runs broke off or oscillated, in a trial that "
        f"all solvers ran; or a mean is surely worse by more than {TOO_MUCH:g} tolerances. docs/solvers.md gives the "
        "rules.",
        "Right: share of problems whose answer was called optimal and is verified, or that were rightly called "
        "infeasible. Problems refused as inconsistent do not count. Wrong: number of silently wrong answers. Dash (–): "
        "not run or not judged.",
    ]
    if any(row["trials"] for row in rows):
        columns += [
            Column("damage", "worst loss", section=CLOSED, help="the mean with the largest loss / tolerance"),
            Column("tip_change", "tip model/ registered", unit="%", section=CLOSED, help="change relative to DCAC"),
        ]  # fmt: skip
        said += [
            "Worst loss: change relative to ★ of the closed-loop mean whose loss is the largest multiple of its "
            f"tolerance. Tolerances: mean mu {100 * COSTS['mu_mean'][1]:g} %, tip and RCM errors "
            f"{100 * COSTS[FRAMED[0]][1]:g} %, chatter (rms of the torque's rate of change) "
            f"{100 * COSTS['torque_rate_rms_Nm_per_s'][1]:g} %. None: no mean is worse by more than its "
            "tolerance. Undecided: one may be.",
            "Tip: change of the tip error relative to DCAC, by the robot's kinematic model / in the registered frame, "
            f"over the trials that all solvers ran (?: undecided). {_trials_told(rows)}",
        ]
    caption = "\n".join(f"- {line}" for line in said)
    return Table("Solvers under the settings we recommend, best first", columns, rows, caption)


def _trials(rows: Sequence[Row]) -> list[int]:
    return sorted({row["closed"]["trials"] for row in rows if row["closed"].get("trials")})


def _trials_told(rows: Sequence[Row]) -> str:
    fewest, *more = _trials(rows)
    if not more:
        return f"Every solver ran {fewest} trial{'s' * (fewest > 1)}."
    all_of = [row["solver"] for row in rows if row["closed"].get("trials") == more[-1]]
    return f"{listed(all_of)} ran {more[-1]} trials, the others {'at least ' if more[1:] else ''}the first {fewest}."


def _tip_in_both_frames(runs: Results, solver: str) -> str | None:
    changes = [runs.change(name, solver) for name in FRAMED if name.startswith("tip")]
    if any(change is None or change.ratio.samples < LEAST_TRIALS for change in changes):
        return None
    return "/".join(f"{change.ratio.value:+.0f}" + "?" * change.undecided for change in changes if change)


def pictures(summary: Summary, rows: Sequence[Row], deadline_us: float) -> list[Picture]:
    """Draw the pictures of the first screen."""
    found = list[Picture]()
    points = {
        row["solver"]: (row["p50_us"], max(row["relative_max"], FLOOR)) for row in rows
        if row["verdict"] is not OTHER and row["p50_us"] is not None and row["relative_max"] is not None
    }
    if points:
        where = "certified problem" if "testsets" in summary else "recorded problem"
        drawn = figures.accuracy_against_time(
            points, x_label="median time of a warm solve [us]", y_label=f"largest relative residual of any {where}",
        )  # fmt: skip
        best = listed(figures.pareto(points))
        says = f"Lower left is better. No other solver is both faster and more accurate than {best}."
        found.append(Picture(drawn, says, "accuracy-against-time"))
    tones = {row["solver"]: TONES[row["verdict"]] for row in rows}
    gains = {row["solver"]: gain for row in rows if (gain := ends(row["closed"], "mu_gain_percent")) is not None}
    if gains:
        poor = [row["solver"] for row in rows if row["solver"] in gains and str(row["damage"]).endswith("% mu")]
        few = too_few(max(row["trials"] for row in rows))
        says = f"Gain of mean manipulability over `{BASELINE}` with its 95 % interval over the trials: " + (
            few or f"{listed(poor) if poor else 'no solver'} clearly fell behind the best solver."
        )
        drawn = intervals_picture(gains, "gain of mean mu [%]", {"no gain": 0.0}, tones)
        found.append(Picture(drawn, says, "closed-loop-effect"))
    ticks = {
        row["solver"]: (at["tick_p50_us"], at["tick_p99_us"], at["tick_p99_9_us"])
        for row in rows if (at := row["closed"]).get("tick_p99_9_us")
    }  # fmt: skip
    if ticks:
        late = [name for name, (*_, slowest) in ticks.items() if slowest > deadline_us]
        says = "Time of a whole tick in closed loop, from the median to the 99.9th percentile (dot: p99): " + (
            f"{listed(late)} sometimes missed the deadline of {deadline_us:g} us."
            if late else f"the 99.9th percentile of every solver meets the deadline of {deadline_us:g} us."
        )  # fmt: skip
        drawn = intervals_picture(ticks, "time of a tick [us]", {"deadline": deadline_us}, tones, log=True)
        found.append(Picture(drawn, says, "deadlines"))
    return found
