"""The time of a run over its lower limit: MuJoCo's own steps of the plant, and the exported tick in C.

Times are those of runs that took turns, so that a slow moment of the machine hits all of them alike; each ratio is the
median of the rounds' ratios.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from moc_opt.scenario import Scenario, Setup

TICKS = 2000
"""So many control periods are stepped at once."""


def steps_us(scenario: Scenario) -> float:
    """Time MuJoCo's own steps of one control period [us]: no Python between them, no trocar, no sensors of ours."""
    plant = Setup(scenario).plant
    steps = TICKS * plant.settings.substeps
    begin = perf_counter()
    mujoco.mj_step(plant.mj_model, plant.mj_data, nstep=steps)
    return 1e6 * (perf_counter() - begin) / TICKS


def ratios(rows: Sequence[Mapping[str, Any]], steps: Sequence[float], c_tick_us: float | None) -> dict[str, float]:
    """Compute the ratios of whole run to loop, and of loops to their limit.

    Args:
        rows: of ``loop.factors``: a round's time of a tick ``us_per_tick`` by name: python, c, judged.
        steps: ``steps_us`` of each round.
        c_tick_us: the exported tick in its own loop; None: not measured.
    """
    walls: dict[str, list[float]] = {}
    for row in rows:
        walls.setdefault(row["name"], []).append(row["us_per_tick"])
    us = {name: np.array(found) for name, found in walls.items()}
    found = {"steps_us": float(np.median(steps))}
    if "judged" in us:
        found["judged_over_loop"] = float(np.median(us["judged"] / us["python"]))
    if c_tick_us is not None:
        limit = np.array(steps) + c_tick_us
        found["limit_us"] = float(np.median(limit))
        found |= {f"{name}_over_limit": float(np.median(us[name] / limit)) for name in ("python", "c") if name in us}
    return found
