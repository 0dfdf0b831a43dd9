"""Which solver to take and which to avoid: one verdict for each, by stated rules, from the numbers of the study.

In this order, the first that applies:

- **other**: it answers another problem, the nonlinear one of the same tick, which the judge of the linear one cannot
  verify; no count of the judge is held against it.
- **avoid**: it claimed success for a wrong answer, hung, crashed, broke off a trial, or costs in closed loop more than
  five times what counts as equal.
- **near**: it never claims an optimum, or costs more in closed loop than counts as equal.
- **gaps**: less than 99 % of the certified problems answered rightly, and said so each time.
- **sound**: none of these. Of them **take** the one with the lowest 99th percentile of its time.

Equal in closed loop are mean manipulability within 1 %, mean errors within 5 % and chatter within 10 % of the solver
that is taken, over the same trials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.solver_study.cells import RIGHTLY, share_right
from benchmarks.solver_study.compare import CLOSED, HARMLESS
from benchmarks.solver_study.settings import QPSOLVERS
from benchmarks.solver_study.study import NONLINEAR
from moc_opt.comparison.trials import BASELINE
from moc_opt.figures.notation import Mark, Missing

Summary = Mapping[str, Any]
Row = dict[str, Any]

TAKE = Mark("★", "take", "best", 0)
SOUND = Mark("✔", "sound", "good", 1)
GAPS = Mark("◐", "gaps", "fair", 2)
NEAR = Mark("≈", "near", "fair", 3)
OTHER = Mark("≠", "other", "other", 4)
AVOID = Mark("✘", "avoid", "bad", 5)
TOO_MUCH = 5.0
"""Times what counts as equal: from there on a solver is to be avoided."""
SHORT = {
    "mu_mean": "mu", "tip_error_model_mean_mm": "tip", "rcm_error_model_mean_mm": "RCM",
    "torque_rate_rms_Nm_per_s": "chatter",
}  # fmt: skip
BEST_MU, BOUND_MU = "mu_fraction_of_best", "mu_fraction_of_bound"
BEGINNING = "ran the beginning of each trial: its share is of other ticks; the damage is by the same ticks of both"
TOLD = "answers the nonlinear problem of the tick: not comparable"


def assess(summary: Summary) -> list[Row]:
    """Return one row for each solver under its recommended setting, the best first; parts may be missing yet.

    A library that qpsolvers calls as well is judged where its own adapter calls it.
    """
    sets, warm, closed = (summary.get(part, {}) for part in ("testsets", "open_loop_warm", "closed_loop"))
    recommended = {n.removesuffix("@recommended"): m for n, m in sets.items() if n.endswith("@recommended")}
    every = dict.fromkeys([*recommended, *warm, *(n for n in closed if n != BASELINE)])
    names = [n for n in every if n.removeprefix(QPSOLVERS) == n or n.removeprefix(QPSOLVERS) not in every]
    rows = [_figures(n, recommended.get(n, {}), warm.get(n, {}), closed.get(n, {})) for n in names]
    for row in rows:
        row["verdict"] = _alone(row)
    reference = _reference(rows)
    for row in rows:
        costs = {} if reference is None else _costs(*_same_ticks(summary, row, reference))
        row["damage"], size = _damage(row["closed"], costs)
        if row["verdict"] not in (OTHER, AVOID) and size > 1.0:
            row["verdict"] = AVOID if size > TOO_MUCH else NEAR
    sound = [row for row in rows if row["verdict"] is SOUND and row["p99_us"] is not None]
    if sound:
        min(sound, key=lambda row: row["p99_us"])["verdict"] = TAKE
    return sorted(rows, key=_order)


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
        "trials": closed.get("runs"),
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


def _reference(rows: Sequence[Row]) -> Row | None:
    """Return what is compared with: of the solvers that ran in closed loop the soundest, fastest one."""
    ran = [row for row in rows if row["closed"].get("mu_mean") is not None and row["verdict"] is not OTHER]
    return min(ran, key=_order, default=None)


def _order(row: Row) -> tuple[float, float, float]:
    p99 = row["p99_us"]
    right = row["right_percent"]
    gaps = -right if row["verdict"] is GAPS and isinstance(right, float) else 0.0
    return row["verdict"].rank, gaps, float("inf") if p99 is None else p99


def _same_ticks(summary: Summary, row: Row, reference: Row) -> tuple[Row, Row]:
    """Return the figures of both over the same ticks: those of the beginning where one ran no more than that."""
    if bool(row["closed"].get("short_runs")) == bool(reference["closed"].get("short_runs")):
        return row["closed"], reference["closed"]
    beginning = summary.get("closed_loop_beginning", {})
    return beginning.get(row["solver"], {}), beginning.get(reference["solver"], {})


def _costs(mine: Row, theirs: Row) -> dict[str, tuple[float, float]]:
    """Return metric -> percent by which it differs from the reference's, and that over what is harmless."""
    found = {}
    for metric, more_is_better in CLOSED.items():
        a, b = mine.get(metric), theirs.get(metric)
        if a is None or not b:
            continue
        change = a / b - 1.0
        found[metric] = 100.0 * change, (-change if more_is_better else change) / HARMLESS[metric]
    return found


def _damage(closed: Row, costs: Mapping[str, tuple[float, float]]) -> tuple[Any, float]:
    """Return the worst of it in words, and how many times as much as counts as equal."""
    for word, count in _ended(closed).items():
        if count:
            return f"{count} {word}", TOO_MUCH
    if not costs:
        return Missing("not run in closed loop"), 0.0
    metric = max(costs, key=lambda name: costs[name][1])
    change, size = costs[metric]
    return (f"{change:+.0f}% {SHORT[metric]}" if size > 1.0 else "none"), size
