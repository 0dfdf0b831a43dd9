"""Named sets of control settings."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

# The settings of Su et al. (2019), with the gains of Table I.
PAPER: dict[str, Any] = {
    "gains": None, "feedforward": False, "rcm_lambda": 0.5, "k0_per_s": 0.1, "regularization": 0.0,
    "observer_gain_per_s": 0.0, "speed_fraction": 1.0, "limit_margin_rad": 0.0, "limit_margin_m": 0.0,
    "shaft_margin": 0.0, "fallback": "damping", "ramp_s": 0.0,
}  # fmt: skip

# Found by a random search for the LWR4+ in the realistic plant.
TUNED: dict[str, Any] = {
    "gains": "tuned", "fallback": "damping", "observer_gain_per_s": 33.3, "feedforward": True, "k0_per_s": 1.58,
    "regularization": 3.24e-5, "speed_fraction": 0.49, "ramp_s": 0.653,
    "course_observer_gain_per_s": 28.0,  # at 33 or 40 /s, an arm without friction is unstable with a delay of 3 ticks
}  # fmt: skip

# Softened by hand until the loop tolerates a delay of four ticks.
ROBUST: dict[str, Any] = {
    **TUNED, "gains": "robust", "observer_gain_per_s": 22.0, "course_observer_gain_per_s": 22.0
}  # fmt: skip

PRESETS: Mapping[str, dict[str, Any]] = MappingProxyType({"paper": PAPER, "tuned": TUNED, "robust": ROBUST})
"""For each preset, the settings that differ from the defaults."""
