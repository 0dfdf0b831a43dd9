"""Mean mu, errors and trocar force of a run while the elbow travels to its optimum, and after that."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.study.results import PHASES
from moc_opt.study.trials import Run


def with_phases(runs: Iterable[Run]) -> list[Run]:
    """Add to each run its means while the elbow travels (``travelling_NAME``) and afterwards (``settled_NAME``).

    All runs of a trial have the same phases: a tick counts as travelling if the elbow travels in at least one of them.
    """
    runs = list(runs)
    groups: dict[tuple[Any, ...], list[Run]] = {}
    for run in runs:
        groups.setdefault(_of_trial(run), []).append(run)
    phases = {}
    for name, mine in groups.items():
        flags = [run.columns["travelling"].astype(bool) for run in mine if "travelling" in run.columns]
        if flags and len({len(flag) for flag in flags}) == 1:
            phases[name] = np.any(flags, axis=0)
    found = []
    for run in runs:
        moving = phases.get(_of_trial(run))
        if moving is None or not run.columns or len(run.columns["t_s"]) != len(moving):
            found.append(run)
            continue
        row = dict(run.row)
        for phase, ticks in zip(PHASES, (~moving, moving), strict=True):
            row[f"{phase}_ticks"] = int(ticks.sum())
            if ticks.any():
                row |= {f"{phase}_{name}": value for name, value in _means(run.columns, ticks).items()}
        found.append(replace(run, row=row))
    return found


def _of_trial(run: Run) -> tuple[Any, ...]:
    return tuple(run.row.get(key) for key in ("trial", "group", "robot"))


def _means(columns: Mapping[str, Array], ticks: Array) -> dict[str, float]:
    found = {"mu_mean": float(columns["mu"][ticks].mean())}
    for name, column in columns.items():
        if "_error_" in name:
            found[f"{name.removesuffix('_m')}_mean_mm"] = 1e3 * float(column[ticks].mean())
    return found | {"trocar_force_mean_N": float(np.linalg.norm(columns["trocar_force_N"][ticks], axis=-1).mean())}
