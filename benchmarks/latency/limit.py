"""The time of a run over its lower limit: MuJoCo's own steps of the plant, and the exported tick in C.

MuJoCo's time depends on the state: dry friction, joint limits and the trocar's force are constraints and forces that an
arm left alone does not have. So the steps are those of a recorded run, from its own states under its own forces.

Times are those of runs that took turns, so that a slow moment of the machine hits all of them alike; each ratio is the
median of the rounds' ratios.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.scenario import Scenario, Setup

TICKS = 2000
"""So many control periods are stepped at once."""
_STATE, _FORCES = mujoco.mjtState.mjSTATE_FULLPHYSICS, mujoco.mjtState.mjSTATE_QFRC_APPLIED
_PUSHES = mujoco.mjtState.mjSTATE_XFRC_APPLIED


class Steps:
    """MuJoCo's own steps of the control periods of a run: no Python between them, no trocar, no sensors of ours.

    Attributes:
        states: (k, m) of MuJoCo before each period, its time first.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Record a run of the scenario, with the tick in Python.

        Each period is stepped from its own state, under the forces of the step before it.
        """
        # Late: a process that measures other parts needs no threads of MuJoCo's.
        from mujoco.rollout import rollout

        setup = Setup(scenario.change(control={"backend": "python"}))
        self._plant, self._rollout = setup.plant, rollout
        found: list[tuple[Array, Array, Array]] = []

        def watch(tick: int) -> None:
            if tick < TICKS:
                at = self._plant.mj_data
                found.append((self._read(_STATE), self._read(_FORCES | _PUSHES), np.array(at.qacc_warmstart)))

        setup.trace(watch)
        self.states, forces, self._warm = (np.array(part) for part in zip(*found, strict=True))
        self._forces = forces[:, None]

    def _read(self, what: int) -> Array:
        model, found = self._plant.mj_model, np.empty(mujoco.mj_stateSize(self._plant.mj_model, what))
        mujoco.mj_getState(model, self._plant.mj_data, found, what)
        return found

    def stepped(self) -> Array:
        """Step every period once, and return the states (k, m) after each."""
        states, _ = self._rollout(
            self._plant.mj_model, self._plant.mj_data, self.states, self._forces, control_spec=_FORCES | _PUSHES,
            nstep=self._plant.settings.substeps, initial_warmstart=self._warm,
        )  # fmt: skip
        after: Array = states[:, -1]
        return after

    def us(self) -> float:
        """Time one control period's steps [us], the mean over all of them."""
        begin = perf_counter()
        self.stepped()
        return 1e6 * (perf_counter() - begin) / len(self.states)

    def alone_us(self) -> float:
        """Time as many periods of an arm that is left alone at home, one after the other, and return the mean [us]."""
        self._plant.reset(self._plant.data.q_home)
        steps = TICKS * self._plant.settings.substeps
        begin = perf_counter()
        mujoco.mj_step(self._plant.mj_model, self._plant.mj_data, nstep=steps)
        return 1e6 * (perf_counter() - begin) / TICKS


def ratios(
    rows: Sequence[Mapping[str, Any]], steps: Sequence[float], alone: Sequence[float], c_tick_us: float | None
) -> dict[str, float]:
    """Compute the ratios of whole run to loop, and of loops to their limit.

    Args:
        rows: of ``loop.factors``: a round's time of a tick ``us_per_tick`` by name: python, c, judged.
        steps: ``Steps.us`` of each round.
        alone: ``Steps.alone_us`` of each round; no ratio is taken of it.
        c_tick_us: the exported tick in its own loop; None: not measured.
    """
    walls: dict[str, list[float]] = {}
    for row in rows:
        walls.setdefault(row["name"], []).append(row["us_per_tick"])
    us = {name: np.array(found) for name, found in walls.items()}
    found = {"steps_us": float(np.median(steps)), "steps_alone_us": float(np.median(alone))}
    if "judged" in us:
        found["judged_over_loop"] = float(np.median(us["judged"] / us["python"]))
    if c_tick_us is not None:
        limit = np.array(steps) + c_tick_us
        found["limit_us"] = float(np.median(limit))
        found |= {f"{name}_over_limit": float(np.median(us[name] / limit)) for name in ("python", "c") if name in us}
    return found
