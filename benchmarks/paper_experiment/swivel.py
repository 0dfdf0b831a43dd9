"""The gain of MOC over the start of the elbow: the same trial from every place of the feasible self-motion.

A start at the swivel of the largest mu gains next to nothing, so the mean gain of an experiment says as much about the
draw of its starts as about the controller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.paper_experiment.trials import MATCHED, variant
from moc_opt import scenario
from moc_opt.errors import MocOptError
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.scenario import Scenario
from moc_opt.trace.ending import Ending


@dataclass(frozen=True)
class Start:
    """One start: the place on the self-motion in [0, 1], the pose, and mu there."""

    fraction: float
    q: tuple[float, ...]
    mu: float
    best: bool


def starts(trial: Scenario, count: int) -> list[Start]:
    """Return evenly spread starts, and one at the largest mu."""
    robot = trial.robot.arm()
    home = robot.data.q_home if trial.start.q_rad is None else trial.start.q_rad
    curve = self_motion(robot, home)
    found = []
    for fraction in np.linspace(0.05, 0.95, count).tolist():
        pose = curve.at(fraction)
        found.append(Start(fraction, tuple(pose.tolist()), robot.state(pose).mu, best=False))
    top = int(np.argmax(curve.mu))
    place = float((curve.s[top] - curve.s[0]) / (curve.s[-1] - curve.s[0]))
    found.append(Start(place, tuple(curve.best.tolist()), curve.mu_best, best=True))
    return sorted(found, key=lambda start: start.fraction)


def gain(job: tuple[Scenario, Start, str]) -> dict[str, Any]:
    """Run DCAC and MOC from one start; one row of rows.parquet."""
    trial, start, solver = job
    row: dict[str, Any] = {
        "part": "swivel", "fraction": start.fraction, "mu_start": start.mu, "at_maximum": start.best,
    }  # fmt: skip
    case = trial.change(start={"pose": "home", "q_rad": start.q, "swivel": "given"})
    try:
        runs = {name: scenario.run(variant(case, name)) for name in (MATCHED, solver)}
    except MocOptError as error:
        return {**row, "ended": "failed", "error": f"{type(error).__name__}: {error}"}
    endings = [str(trace.meta["ended"]) for trace in runs.values()]
    row["ended"] = max(endings, key=lambda ended: list(Ending).index(Ending.of(ended)))
    if not Ending.of(row["ended"]).whole:
        return {**row, "error": row["ended"]}
    means = {name: float(trace.mu.mean()) for name, trace in runs.items()}
    row |= {"mu_dcac": means[MATCHED], "mu_moc": means[solver]}
    return {**row, "gain_percent": 100.0 * (means[solver] / means[MATCHED] - 1.0)}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the gain at the maximum, and the largest and mean gain over the other starts [percent]."""
    known = [row for row in rows if "gain_percent" in row]
    others = [row for row in known if not row["at_maximum"]]
    spread = [row["gain_percent"] for row in others]
    at_top = [row["gain_percent"] for row in known if row["at_maximum"]]
    found: dict[str, Any] = {"starts": len(rows), "broke_off": len(rows) - len(known)}
    if spread:
        found |= {
            "gain_mean_percent": 100.0 * (
                sum(row["mu_moc"] for row in others) / sum(row["mu_dcac"] for row in others) - 1.0
            ),
            "gain_max_percent": max(spread), "gain_min_percent": min(spread),
        }  # fmt: skip
    return {**found, "gain_at_maximum_percent": at_top[0]} if at_top else found
