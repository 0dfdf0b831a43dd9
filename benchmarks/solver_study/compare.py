"""Tables held against each other: is closed loop predicted, how far apart are duals, who is fast how often?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from scipy import stats

from moc_opt.arrays import Array
from moc_opt.figures.notation import Doubtful
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.study.statistics import too_few

Figures = Mapping[str, Mapping[str, Any]]

# Of both tables: name -> whether more is better.
OPEN = {"primal_p50": False, "relative_p50": False, "loss_p50": False, "loss_max": False, "solve_p50_us": False}
CLOSED = {
    "mu_mean": True, "tip_error_model_mean_mm": False, "rcm_error_model_mean_mm": False,
    "torque_rate_rms_Nm_per_s": False,
}  # fmt: skip
WORDS = {
    "primal_p50": "median primal residual", "relative_p50": "median relative residual",
    "loss_p50": "median self-motion loss", "loss_max": "largest self-motion loss",
    "solve_p50_us": "median solve time", "mu_mean": "manipulability", "tip_error_model_mean_mm": "tip error",
    "rcm_error_model_mean_mm": "RCM error", "torque_rate_rms_Nm_per_s": "chatter",
}  # fmt: skip

# Closed-loop figures this close to each other, relative to their size, say the same: no cost, no difference in rank.
HARMLESS = {
    "mu_mean": 0.01, "tip_error_model_mean_mm": 0.05, "rcm_error_model_mean_mm": 0.05,
    "torque_rate_rms_Nm_per_s": 0.1,
}  # fmt: skip
# Errors in the frame registered at the start.
PATIENT = ("tip_error_registered_mean_mm", "rcm_error_registered_mean_mm")
# What a solver may cost: name -> (whether more is better, what is harmless).
COSTS = {**{name: (up, HARMLESS[name]) for name, up in CLOSED.items()}, **dict.fromkeys(PATIENT, (False, 0.05))}


def levels(values: Sequence[float], metric: str) -> Array:
    """Round the values to steps of what is harmless, so that noise decides no rank; not where one is not positive."""
    array = np.asarray(values, dtype=float)
    if metric not in HARMLESS or not (array > 0.0).all():
        return array
    return np.asarray(np.round(np.log(array) / np.log1p(HARMLESS[metric])))


def ranks(values: Sequence[float] | Array, more_is_better: bool) -> Array:
    """Rank the values, 1 for the best; ties share the mean of their ranks."""
    array = np.asarray(values, dtype=float)
    found: Array = stats.rankdata(-array if more_is_better else array)
    return found


def correlations(open_loop: Figures, closed_loop: Figures) -> dict[str, dict[str, Any]]:
    """Compute Spearman's rank correlation of each open-loop with each closed-loop figure, over the names in both.

    Both are ranked from good to bad, so that +1 says: what is better in open loop is better in closed loop.

    Returns:
        "open ~ closed" -> {rank_correlation, p_value, solvers, open, closed}; pairs without spread are left out.
    """
    found: dict[str, dict[str, Any]] = {}
    for one, one_up in OPEN.items():
        for other, other_up in CLOSED.items():
            names = _shared(open_loop, one, closed_loop, other)
            a = ranks([open_loop[name][one] for name in names], one_up)
            b = ranks(levels([closed_loop[name][other] for name in names], other), other_up)
            if len(names) < 4 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
                continue
            result = stats.spearmanr(a, b)
            found[f"{one} ~ {other}"] = {
                "rank_correlation": float(result.statistic), "p_value": float(result.pvalue), "solvers": len(names),
                "open": one, "closed": other,
            }  # fmt: skip
    return found


def disagreements(
    open_loop: Figures, closed_loop: Figures, one: str, other: str, count: int = 5
) -> list[dict[str, Any]]:
    """Find where the two rankings lie furthest apart: name, both ranks, both values, and in words."""
    names = _shared(open_loop, one, closed_loop, other)
    if len(names) < 4:
        return []
    a = ranks([open_loop[name][one] for name in names], OPEN[one])
    b = ranks(levels([closed_loop[name][other] for name in names], other), CLOSED[other])
    found = []
    for i in np.argsort(-np.abs(a - b), kind="stable")[:count]:
        if a[i] == b[i]:
            break
        better = "better in closed loop than in open loop" if b[i] < a[i] else "worse in closed loop than in open loop"
        x, y = open_loop[names[i]][one], closed_loop[names[i]][other]
        found.append({
            "name": names[i], "open_rank": float(a[i]), "closed_rank": float(b[i]), "open": float(x),
            "closed": float(y), "of": len(names),
            "words": f"{names[i]} does {better}: place {a[i]:g} of {len(names)} by {WORDS[one]} ({x:.2g}), "
                     f"place {b[i]:g} by {WORDS[other]} ({y:.4g})",
        })  # fmt: skip
    return found


def verdict(found: Figures, trials: int) -> str:
    """Say in words what the correlations mean; of too few trials nothing is claimed."""
    if not found:
        return "Too few solvers ran in both parts for a rank correlation."
    if few := too_few(trials):
        return f"Whether open loop predicts closed loop: {few}."
    said = []
    for closed in CLOSED:
        mine = [v for v in found.values() if v["closed"] == closed and v["open"] != "solve_p50_us"]
        if not mine:
            continue
        best = max(mine, key=lambda v: abs(v["rank_correlation"]))
        r = best["rank_correlation"]
        if best["p_value"] > 0.05:
            said.append(f"no residual of open loop predicts {WORDS[closed]} (the closest: {r:+.2f})")
        elif r > 0.0:
            said.append(f"{WORDS[closed]} follows the {WORDS[best['open']]} of open loop (rank correlation {r:+.2f})")
        else:
            said.append(
                f"{WORDS[closed]} goes against the {WORDS[best['open']]} of open loop: the more accurate answers are "
                f"the worse ones there (rank correlation {r:+.2f})"
            )
    text = "; ".join(said)
    return f"{text[0].upper()}{text[1:]}."


def _shared(one: Figures, a: str, other: Figures, b: str) -> list[str]:
    known = [n for n, m in one.items() if m.get(a) is not None and other.get(n, {}).get(b) is not None]
    return [n for n in known if not isinstance(one[n][a], Doubtful)]


# --- duals ---


def dual_distances(problems: Sequence[NullSpaceQP], duals: Mapping[str, Array]) -> dict[str, dict[str, Any]]:
    """Measure how far the multipliers (k, 6) of any two solvers lie apart on the same problems.

    Each distance is |y_a - y_b|_inf over c2 |grad_mu|_inf, so that 1 is the size of the whole cost. ``along`` is the
    part on the null vector [u; -u] of the six rows, which no optimality condition determines; ``across`` the rest.

    Returns:
        "a | b" -> {p50, max, along_p50, across_p50, across_max, problems}.
    """
    u = np.array([np.linalg.svd(qp.J_tip - qp.J_wrist)[0][:, 2] for qp in problems])
    null = np.concatenate([u, -u], axis=1) / np.sqrt(2.0)
    scale = np.array([max(qp.c2 * np.abs(qp.pull).max(), 1e-300) for qp in problems])
    found = {}
    for a, b in combinations(duals, 2):
        both = np.isfinite(duals[a]).all(axis=1) & np.isfinite(duals[b]).all(axis=1)
        if not both.any():
            continue
        gap = (duals[a] - duals[b])[both] / scale[both, None]
        along = np.einsum("ki,ki->k", gap, null[both])
        across = np.abs(gap - along[:, None] * null[both]).max(axis=1)
        size = np.abs(gap).max(axis=1)
        found[f"{a} | {b}"] = {
            "p50": float(np.median(size)), "max": float(size.max()), "along_p50": float(np.median(np.abs(along))),
            "across_p50": float(np.median(across)), "across_max": float(across.max()), "problems": int(both.sum()),
        }  # fmt: skip
    return found


def dual_verdict(six: Figures, five: Figures) -> str:
    """Say in words what the distances mean."""
    if not six or not five:
        return "Fewer than two solvers gave duals on six and on five rows."
    worst = max(six, key=lambda pair: six[pair]["p50"])
    best = max(five, key=lambda pair: five[pair]["p50"])
    return (
        f"On six rows the duals of {worst.replace(' | ', ' and ')} lie {six[worst]['p50']:.2g} times the whole cost "
        f"apart (median), {six[worst]['across_p50']:.1g} of it across the direction that the dependent row leaves "
        f"free. On five rows no two lie further apart than {five[best]['p50']:.2g} ({best.replace(' | ', ' and ')})."
    )


# --- performance profiles ---


def profile(costs: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Compute Dolan and More's performance profiles (2002).

    Args:
        costs: name -> cost per problem (k,), infinite where it was not solved; at least 0.

    Returns:
        ratios tau (m,), and name -> the share of problems (m,) on which it was within tau times the best.
    """
    table = np.array(list(costs.values()), dtype=float)
    best = table.min(axis=0)
    solvable = np.isfinite(best)
    ratio = np.full_like(table, np.inf)
    ratio[:, solvable] = table[:, solvable] / best[solvable]
    finite = ratio[np.isfinite(ratio)]
    top = max(float(finite.max()), 2.0) if finite.size else 2.0
    tau = np.logspace(0.0, np.log10(top), 200)
    shares = {
        name: np.array([(row <= t * (1.0 + 1e-12)).mean() for t in tau])
        for name, row in zip(costs, ratio, strict=True)
    }
    return tau, shares
