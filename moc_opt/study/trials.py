"""The trials of a comparison: one scenario a seed, and the same one under each controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from moc_opt.scenario import Scenario, Setup

BASELINE = "dcac"
"""Tip and RCM alone, with the gains of the others."""


def placed(trial: Scenario) -> Scenario:
    """Return the trial with its drawn pose written out: many controllers start there, and it is searched for once."""
    q = Setup(trial).q_start.tolist()
    return trial.change(start={"pose": "home", "q_rad": q, "swivel": "given", "check_path": False})


def variant(trial: Scenario, controller: str, settings: Mapping[str, Any] | None = None) -> Scenario:
    """Return the trial under DCAC (with MOC's gains) or under MOC with the named solver."""
    if controller == BASELINE:
        return trial.change(control=trial.control.matched_dcac())
    return trial.change(solver={"name": controller, "settings": dict(settings or {})})
