"""The trials of the closed loop: one scenario per task and seed, under the baseline or under a solver."""

from __future__ import annotations

from collections.abc import Sequence

from moc_opt.comparison.trials import placed
from moc_opt.scenario import Scenario


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
