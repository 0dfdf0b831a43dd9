"""A receding horizon with V leaves the hump that traps a climb, and what it follows is where its path asks it to be."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.planning.receding import Receding
from moc_opt.scenario import Scenario, Setup
from moc_opt.trace.trace import Trace

TRAPPED = Scenario(seed=105, bound_samples=0, judge=False).change(
    control={"preset": "tuned", "third_level": "receding"}, start={"pose": "random"}, task={"path": "circle"}
)
"""A start in the lower of two humps: the way to the higher one goes through a valley of half the mu."""


@cache
def setup() -> Setup:
    return Setup(TRAPPED)


def guide() -> Receding:
    found = setup().controller()._guide
    assert isinstance(found, Receding)
    return found


@cache
def ran() -> Trace:
    return mo.run(TRAPPED)


def test_it_leaves_the_hump_in_which_the_local_law_is_trapped() -> None:
    local = mo.run(TRAPPED.change(control={**TRAPPED.control.model_dump(), "third_level": "local"}))
    assert ran().meta["ended"] == "completed"
    assert ran().mu[-500:].mean() > 1.15 * local.mu[-500:].mean()
    assert ran().mu.mean() > local.mu.mean()


def test_a_horizon_that_sees_no_further_stays_in_the_hump(monkeypatch: pytest.MonkeyPatch) -> None:
    """V is what sees the other hump: without it the same program ends where the local law does."""
    blind = guide()
    monkeypatch.setattr(blind._to_go, "value", blind._to_go._gain)
    q = _followed(blind, setup())
    top = setup().robot.mu_along(q)[-1]
    assert top < 0.9 * ran().mu[-500:].mean()


def _followed(one: Receding, of: Setup) -> np.ndarray:
    """Poses of an arm that goes where it is asked to at once."""
    one.start()
    q, poses = np.array(of.q_start), []
    for _ in range(of.ticks):
        wish = one.wish(of.robot.state(q))
        q = q + wish / one._lead * one._period
        poses.append(q)
    return np.array(poses)
