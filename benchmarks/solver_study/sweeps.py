"""Effects of inaccuracy, damping, a narrow box and missed deadlines in closed loop: one setting is swept at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.solver_study import combine
from benchmarks.solver_study.closed_loop import Asked, Run, Runner, run_each
from benchmarks.solver_study.compare import HARMLESS, WORDS
from benchmarks.solver_study.settings import SolverSetting
from moc_opt.arrays import Array
from moc_opt.scenario import Scenario
from moc_opt.study.trials import variant

# Without the supervisor's residual check: the sweep shows the effect of an answer, not of its replacement.
UNCHECKED: dict[str, Any] = {"supervisor": {"check": False}}
FALLBACKS = ("least-violation", "damping", "hold")  # of an infeasible subproblem; the default first
LATE = ("hold", "zero", "iterate")  # what answers a solve that comes too late


@dataclass(frozen=True)
class Point:
    """One value of what is swept.

    Attributes:
        label: of the value.
        value: on the axis of a figure.
        changes: of the trial's tables.
        setting: the solver to ask in open loop too; None where the sweep is not about a solver's accuracy.
    """

    label: str
    value: float
    changes: Mapping[str, Mapping[str, Any]]
    setting: SolverSetting | None = None


@dataclass(frozen=True)
class Sweep:
    """A family of points, loosest first."""

    name: str
    about: str
    points: Sequence[Point]
    needs: str = "exact"
    group: str = ""
    suffix: str = ""


def accuracy(solver: str, option: str, values: Sequence[float], about: str, **fixed: Any) -> Sweep:
    """Sweep an option of one solver from loose to tight."""
    points = []
    for value in values:
        options = {**fixed, option: value}
        label = f"{option}={value:g}"
        changes = {"solver": {"name": solver, "settings": options}, "control": UNCHECKED}
        points.append(Point(label, float(value), changes, SolverSetting(solver, label, options, about)))
    return Sweep(f"{solver}.{option}", about, points, solver, "accuracy")


def accuracy_sweeps(full: bool) -> list[Sweep]:
    """Sweep tolerances, iterations and steps; costs unscaled, so that tolerances hold for the cost itself.

    Less than ``full`` are the values between which something changes; semi-implicit steps do as explicit ones there.
    """
    powers = [10.0**-k for k in range(1, 10)] if full else [1e-1, 1e-5, 1e-9]
    raw = {"cost_scale": 1.0}
    tolerance = "tolerance on the unscaled cost, five rows"
    steps = [1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 300] if full else [1, 3, 10, 30, 100]
    found = [
        accuracy("osqp", "eps", powers, tolerance, **raw),
        accuracy(
            "osqp", "max_iter", [1, 3, 10, 30, 100] if full else [1, 100],
            "the truncated iterate: stopped after so many", check_termination=1,
        ),
        accuracy("proxqp", "eps", powers, tolerance, **raw),
        accuracy("piqp", "eps", powers, tolerance, **raw),
        accuracy("clarabel", "eps", powers, tolerance, **raw),
        accuracy("daqp", "primal_tol", powers if full else powers[::2], "primal tolerance, five rows, unscaled", **raw),
        accuracy("rnn", "steps", steps, "inner steps a tick, explicit"),
    ]  # fmt: skip
    if not full:
        return found
    return [*found, replace(
        accuracy("rnn", "steps", steps, "inner steps a tick, semi-implicit", method="semi-implicit"),
        name="rnn.steps semi-implicit", suffix=" semi-implicit",
    )]  # fmt: skip


def damping_sweep(full: bool) -> Sweep:
    """Sweep rho from 0, the paper's, up: from a vertex that chatters to an answer that does not move."""
    values = [0.0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2] if full else [0.0, 1e-6, 1e-5, 1e-4, 1e-3]
    points = [
        Point(f"rho={v:g}", v, {"control": {"regularization": v}, "solver": {"name": "exact"}})
        for v in values
    ]
    return Sweep("damping", "rho with c2 = 1e-3, solver exact", points, group="damping")


def box_sweep(full: bool) -> Sweep:
    """Sweep k0 from the paper's 0.1 up, and what replaces the answer of an infeasible subproblem.

    Less than ``full`` ask for the replacements in the paper's box alone, which is infeasible at every fifth tick; a
    wider one hardly ever is.
    """
    values = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0] if full else [0.1, 0.5, 2.0, 5.0]
    points = [
        Point(
            f"k0={v:g} {fallback}", v,
            {"control": {"k0_per_s": v, "fallback": fallback}, "solver": {"name": "exact"}},
        )
        for v in values
        for fallback in (FALLBACKS if full or v == values[0] else FALLBACKS[:1])
    ]  # fmt: skip
    return Sweep("k0", "velocity damper and fallback, solver exact", points, group="k0")


def deadline_sweep(name: str, recorded_us: Array, shares: Sequence[float]) -> Sweep:
    """Sweep a budget that so many percent of the recorded times exceed, and what replaces a late answer.

    The times are replayed from the recording, tick by tick, so that the run can be repeated exactly.
    """
    times = [round(float(t), 3) for t in recorded_us[np.isfinite(recorded_us)]]
    points = []
    for share in shares:
        budget = max(float(np.percentile(times, 100.0 - share)), 1e-3)
        for late in LATE:
            changes: dict[str, dict[str, Any]] = {
                "solver": {"name": name, "settings": {}, "replay_us": times},
                "control": {"supervisor": {"budget_us": budget, "late": late}},
            }
            points.append(Point(f"{share:g}% late, {late}", share, changes))
    return Sweep(f"deadline.{name}", f"recorded times of {name} against a budget", points, name, "deadline")


def run_points(
    run: Runner, points: Sequence[tuple[Sweep, Point]], cases: Mapping[str, Scenario],
    default: Mapping[str, Run] = MappingProxyType({}),
) -> list[list[Run]]:  # fmt: skip
    """Run every point on all trials; several run at a time, so their times mean nothing.

    Args:
        run: `moc_opt.study.run` with the study's folder, workers and progress.
        points: of the sweeps.
        cases: trial -> its scenario.
        default: trial -> the run with `exact` under the default settings, which a point need not repeat.
    """
    asked: list[Asked] = []
    wanted: list[list[Run | int]] = []
    for sweep, point in points:
        mine: list[Run | int] = []
        for trial in cases.values():
            changed = trial.change(**{table: dict(values) for table, values in point.changes.items()})
            if "settings" not in point.changes.get("solver", {}):
                changed = changed.change(solver={"settings": {}})
            if trial.name in default and changed == variant(trial, "exact"):
                mine.append(default[trial.name])
                continue
            mine.append(len(asked))
            asked.append(Asked(f"{sweep.name} {point.label}", changed, whole=False))
        wanted.append(mine)
    done = run_each(run, asked)
    return [[done[one] if isinstance(one, int) else one for one in mine] for mine in wanted]


def figures(point: Point, runs: Sequence[Run], baselines: Sequence[Run]) -> dict[str, Any]:
    """Return the figures of one point without times, and its changes against the baseline."""
    values = {name: value for name, value in combine.combined(runs).items() if not name.endswith("_us")}
    return {"value": point.value, **values, **combine.changes(runs, baselines)}


def begins_in_words(begins: Mapping[str, Mapping[str, str]], trials: int) -> str:
    """Say in words what `beginning_of_cost` found, a clause for each sweep."""
    said = []
    for name, found in begins.items():
        labels = set(found.values())
        solver = name.partition(".")[0] + (" semi-implicit" if "semi-implicit" in name else "")
        parts = ", ".join(f"{WORDS[metric]} from {label} on" for metric, label in found.items())
        if len(labels) == 1:
            parts = f"everything from {labels.pop()} on"
        said.append(f"{solver}: {parts}")
    limits = ", ".join(f"{WORDS[metric]} {100 * limit:g} %" for metric, limit in HARMLESS.items())
    what = f"The mean over {trials} trials as good as that of the tightest setting (within {limits})"
    return f"{what}: " + "; ".join(said) + "." if said else ""


def beginning_of_cost(points: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Find from which value on, from loose to tight, a metric stays within its tolerance of the tightest one's.

    Returns:
        Metric -> label of the loosest value from which on every tighter one is as good as the tightest.
    """
    labels = list(points)
    found: dict[str, str] = {}
    for metric, limit in HARMLESS.items():
        values = [points[label].get(metric) for label in labels]
        last = values[-1]
        if last is None or last == 0.0:
            continue
        start = len(labels) - 1
        while start > 0 and (v := values[start - 1]) is not None and abs(v / last - 1.0) <= limit:
            start -= 1
        found[metric] = labels[start]
    return found
