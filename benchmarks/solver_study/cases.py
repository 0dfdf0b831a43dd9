"""The trials of the closed loop: each has a seed, and so a start, a mismatch and a noise, of its own."""

from __future__ import annotations

from collections.abc import Sequence

from moc_opt.scenario import Scenario
from moc_opt.study.trials import placed


def drawn(base: Scenario, tasks: Sequence[str], seed: int, count: int) -> dict[str, Scenario]:
    """Make ``count`` scenarios, by name; trial k has the seed ``seed + k`` and the k-th task, in turn.

    The seed draws starting pose and swivel, mismatch and noise. Two trials share none, so that they are independent.
    """
    start = {"pose": "random", "swivel": "random"}
    chosen = [(seed + k, tasks[k % len(tasks)]) for k in range(count)]
    return {
        f"{task}/{own}": base.change(name=f"{task}/{own}", seed=own, task={"path": task}, start=start)
        for own, task in chosen
    }


def trials(base: Scenario, tasks: Sequence[str], seed: int, count: int) -> dict[str, Scenario]:
    """Make the scenarios of `drawn`, each with its starting pose written out."""
    return {
        name: placed(trial).change(best_courses=True) for name, trial in drawn(base, tasks, seed, count).items()
    }  # fmt: skip
