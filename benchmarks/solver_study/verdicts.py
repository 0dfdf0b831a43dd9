"""Which solver to take and which to avoid: one verdict for each, by stated rules, from the numbers of the study.

In this order, the first that applies:

- **other**: it answers another problem, the nonlinear one of the same tick, which the judge of the linear one cannot
  verify; no count of the judge is held against it.
- **avoid**: it claimed success for a wrong answer, hung, crashed, broke off a trial, or surely costs in closed loop
  more than five times what counts as equal.
- **near**: it never claims an optimum, or surely costs more in closed loop than counts as equal.
- **gaps**: less than 99 % of the certified problems answered rightly, and said so each time; inconsistent rows that it
  refused are not counted.
- **sound**: none of these. Of them **take** the one with the lowest 99th percentile of its time; where the machine was
  too busy to tell which one that is, the one with the lowest median; where that cannot be told either, none is taken.

Equal in closed loop are mean manipulability within 1 %, mean errors (by the robot's own kinematics and in the
patient's frame, the one registered at the start) within 5 % and chatter within 10 % of the solver that is taken, over
the trials that both ran. A cost is sure where the 95 % intervals of the ratio of the means and of the mean of the
ratios both lie beyond that. Where one of them reaches beyond it the damage is undecided, and where both lie within it
there is none: of neither follows a verdict. Of fewer than 8 trials nothing follows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.solver_study.cells import RIGHTLY, share_right
from benchmarks.solver_study.compare import COSTS
from benchmarks.solver_study.settings import QPSOLVERS
from benchmarks.solver_study.study import NONLINEAR
from moc_opt.figures.notation import Doubtful, Mark, Missing
from moc_opt.study.statistics import Change, StatisticsError, relative_changes, too_few
from moc_opt.study.trials import BASELINE

Summary = Mapping[str, Any]
Row = dict[str, Any]
Values = Mapping[str, Mapping[str, float]]

TAKE = Mark("★", "take", "best", 0)
SOUND = Mark("✔", "sound", "good", 1)
GAPS = Mark("◐", "gaps", "fair", 2)
NEAR = Mark("≈", "near", "fair", 3)
OTHER = Mark("≠", "other", "other", 4)
AVOID = Mark("✘", "avoid", "bad", 5)
TOO_MUCH = 5.0
"""Times what counts as equal: from there on a solver is to be avoided."""
SHORT = {
    "mu_mean": "mu", "tip_error_model_mean_mm": "tip", "tip_error_registered_mean_mm": "patient tip",
    "rcm_error_model_mean_mm": "RCM", "rcm_error_registered_mean_mm": "patient RCM",
    "torque_rate_rms_Nm_per_s": "chatter",
}  # fmt: skip
BEST_MU, BOUND_MU = "mu_fraction_of_best", "mu_fraction_of_bound"
BEGINNING = "ran the beginning of each trial: its share is of other ticks; the damage is by the same ticks of both"
TOLD = "answers the nonlinear problem of the tick: not comparable"


def assess(summary: Summary) -> list[Row]:
    """Return one row for each solver under its recommended setting, the best first; parts may be missing yet.

    ``ranked_by`` is the key of the time that decides among sound ones: see `_ranking`. A library that qpsolvers calls
    as well is judged where its own adapter calls it.
    """
    sets, warm, closed = (summary.get(part, {}) for part in ("testsets", "open_loop_warm", "closed_loop"))
    recommended = {n.removesuffix("@recommended"): m for n, m in sets.items() if n.endswith("@recommended")}
    every = dict.fromkeys([*recommended, *warm, *(n for n in closed if n != BASELINE)])
    names = [n for n in every if n.removeprefix(QPSOLVERS) == n or n.removeprefix(QPSOLVERS) not in every]
    rows = [_figures(n, recommended.get(n, {}), warm.get(n, {}), closed.get(n, {})) for n in names]
    for row in rows:
        row["verdict"] = _alone(row)
    reference = _reference(rows, _ranking(rows))
    for row in rows:
        costs = {} if reference is None else _changes(*_same_ticks(summary, row, reference))
        row["damage"], size = _damage(row["closed"], costs)
        if row["verdict"] not in (OTHER, AVOID) and size > 1.0:
            row["verdict"] = AVOID if size > TOO_MUCH else NEAR
    sound = [row for row in rows if row["verdict"] is SOUND and row["p99_us"] is not None]
    by = _ranking(rows)
    if sound and by:
        min(sound, key=lambda row: _time(row, by))["verdict"] = TAKE
    return [{**row, "ranked_by": by} for row in sorted(rows, key=lambda row: _order(row, by))]


def _ranking(rows: Sequence[Row]) -> str:
    """Return the time by which the fastest sound solver can be told: p99, else the median; "" where there is none.

    A p99 that is not to be trusted is at least its median, which may be more than the least p99 already.
    """
    sound = [row for row in rows if row["verdict"] is SOUND and row["p99_us"] is not None]
    for by in ("p99_us", "p50_us"):
        least = min((_time(row, by) for row in sound), default=0.0)
        if all(_time(row, "p50_us", unknown=0.0) >= least for row in sound if _doubted(row, by)):
            return by
    return ""


def _doubted(row: Row, by: str) -> bool:
    return row[by] is None or isinstance(row[by], Doubtful)


def _time(row: Row, by: str, unknown: float = float("inf")) -> float:
    return unknown if not by or _doubted(row, by) else float(row[by])


def _figures(name: str, certified: Row, warm: Row, closed: Row) -> Row:
    """Return the figures of one solver: certified sets first, the recorded sequence where they were not run."""
    counted = certified or warm
    other = name.startswith(NONLINEAR)
    hidden = Missing(TOLD)
    wrong = sum(int(part.get("silently_wrong") or 0) for part in (certified, closed))
    timed = warm if warm.get("solve_p50_us") is not None else {
        key: certified.get(f"{key}_worst_set") for key in ("solve_p50_us", "solve_p99_us")
    }  # fmt: skip
    share = closed.get(BEST_MU, closed.get(BOUND_MU))
    percent = Missing(BEGINNING) if closed.get("short_runs") else None if share is None else 100.0 * share
    return {
        "solver": name, "counted": counted, "closed": closed,
        "right_percent": hidden if other else 100.0 * share_right(counted) if counted.get("solves") else None,
        "silently_wrong": hidden if other else wrong if counted or closed else None,
        "p50_us": timed.get("solve_p50_us"), "p99_us": timed.get("solve_p99_us"),
        "mu_percent": percent,
        "relative_max": counted.get("relative_max"),
        "trials": closed.get("compared_trials"),
    }  # fmt: skip


def _alone(row: Row) -> Mark:
    """Return the verdict without what the answers do in closed loop to mean figures."""
    counted, closed = row["counted"], row["closed"]
    if row["solver"].startswith(NONLINEAR):
        return OTHER
    broken = sum(counted.get(key, 0) for key in ("hung", "crashed")) + sum(_ended(closed).values())
    if row["silently_wrong"] or broken:
        return AVOID
    if not counted.get("claimed_solved"):
        return NEAR
    return SOUND if share_right(counted) >= RIGHTLY else GAPS


def _ended(closed: Row) -> dict[str, int]:
    return {word: int(closed.get(key) or 0) for word, key in (("broke off", "broke_off"), ("shook", "oscillated"))}


def _reference(rows: Sequence[Row], by: str) -> Row | None:
    """Return what is compared with: of the solvers that ran in closed loop the soundest, fastest one."""
    ran = [row for row in rows if row["closed"].get("mu_mean") is not None and row["verdict"] is not OTHER]
    return min(ran, key=lambda row: _order(row, by), default=None)


def _order(row: Row, by: str) -> tuple[float, float, float]:
    right = row["right_percent"]
    gaps = -right if row["verdict"] is GAPS and isinstance(right, float) else 0.0
    return row["verdict"].rank, gaps, _time(row, by)


def _same_ticks(summary: Summary, row: Row, reference: Row) -> tuple[Values, Values]:
    """Return the values of both by trial, over the same ticks: the beginning where one ran no more than that."""
    short = bool(row["closed"].get("short_runs")) != bool(reference["closed"].get("short_runs"))
    values = summary.get("closed_loop_beginning_trials" if short else "closed_loop_trials", {})
    return values.get(row["solver"], {}), values.get(reference["solver"], {})


def _changes(mine: Values, theirs: Values) -> dict[str, Change]:
    """Return metric -> by how much it differs from the reference's, on the trials that both ran."""
    found = {}
    for metric in COSTS:
        a, b = mine.get(metric, {}), theirs.get(metric, {})
        both = [trial for trial in a if trial in b]
        try:
            found[metric] = relative_changes([a[trial] for trial in both], [b[trial] for trial in both])
        except StatisticsError:
            continue  # no trial that both ran
    return found


def _damage(closed: Row, changes: Mapping[str, Change]) -> tuple[Any, float]:
    """Return the worst of it in words, and how many times what counts as equal it surely is."""
    for word, count in _ended(closed).items():
        if count:
            return f"{count} {word}", TOO_MUCH
    if not changes:
        return Missing("not run in closed loop"), 0.0
    if few := too_few(min(change.ratio.samples for change in changes.values())):
        return few, 0.0
    sizes = {metric: _size(metric, change) for metric, change in changes.items()}
    least, most = (max(sizes, key=lambda name, end=end: sizes[name][end]) for end in (0, 1))  # type: ignore[misc]
    if sizes[least][0] > 1.0:
        return f"{changes[least].ratio.value:+.0f}% {SHORT[least]}", sizes[least][0]
    if sizes[most][1] > 1.0:
        low, high = changes[most].ratio[1:3]
        return f"undecided: {SHORT[most]} [{low:.0f}, {high:.0f}] %", 0.0
    return "none", 0.0


def _size(metric: str, change: Change) -> tuple[float, float]:
    """Return the least and the largest cost that both intervals hold, over what is harmless."""
    more_is_better, harmless = COSTS[metric]
    ends = [(-one.high, -one.low) if more_is_better else (one.low, one.high) for one in change]
    return min(low for low, _ in ends) / (100.0 * harmless), max(high for _, high in ends) / (100.0 * harmless)
