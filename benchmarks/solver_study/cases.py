"""The trials of the closed loop: one scenario per task and seed, under the baseline or under a solver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from moc_opt import scenario
from moc_opt.scenario import Scenario

BASELINE = "dcac"  # tip and RCM alone, with the gains of the others


def trials(base: Scenario, tasks: Sequence[str], seeds: Sequence[int]) -> dict[str, Scenario]:
    """Make one scenario per task and seed; the seed draws the starting pose and swivel, the mismatch and the noise."""
    start = {"pose": "random", "swivel": "random"}
    return {
        f"{task}/{seed}": placed(
            base.change(name=f"{task}/{seed}", seed=seed, task={"path": task}, start=start)
        ).change(best_courses=True)
        for task in tasks
        for seed in seeds
    }


def placed(trial: Scenario) -> Scenario:
    """Return the trial with its drawn pose written out: many controllers start there, and it is searched for once."""
    q = scenario.Setup(trial).q_start.tolist()
    return trial.change(start={"pose": "home", "q_rad": q, "swivel": "given", "check_path": False})


def variant(trial: Scenario, controller: str, settings: Mapping[str, Any] | None = None) -> Scenario:
    """Return the trial under DCAC (with MOC's gains) or under MOC with the named solver."""
    if controller == BASELINE:
        return trial.change(control=trial.control.matched_dcac())
    return trial.change(solver={"name": controller, "settings": dict(settings or {})})
