"""Named sets of control settings: the settings of the paper, the result of a search, and a softer set."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

# Each law has its own gains (Table I of the paper). The wrist error is d / lambda, with the RCM error d. There is no
# observer, no ramp, and no margin to the joint limits.
PAPER: dict[str, Any] = {
    "gains": None, "feedforward": False, "rcm_lambda": 0.5, "k0_per_s": 0.1, "regularization": 0.0,
    "observer_gain_per_s": 0.0, "speed_fraction": 1.0, "limit_margin_rad": 0.0, "limit_margin_m": 0.0,
    "shaft_margin": 0.0, "fallback": "damping", "ramp_s": 0.0,
}  # fmt: skip

# Found by a search over random settings for the LWR4+ in the realistic plant. The gains are in the robot's file. Other
# arms have their own table "tuned", or gains derived from their inertia (`moc_opt.robots.gains`).
TUNED: dict[str, Any] = {
    "gains": "tuned", "fallback": "damping", "observer_gain_per_s": 33.3, "feedforward": True, "k0_per_s": 1.58,
    "regularization": 3.24e-5, "speed_fraction": 0.49, "ramp_s": 0.653,
    "course_observer_gain_per_s": 28.0,  # at 33 or 40 /s, an arm without friction is unstable with a delay of 3 ticks
}  # fmt: skip

# Softened by hand until the loop tolerates a delay of four ticks from command to torque, even without friction and with
# a stiff trocar. The tip error is 1.5 times that of `tuned`.
ROBUST: dict[str, Any] = {
    **TUNED, "gains": "robust", "observer_gain_per_s": 22.0, "course_observer_gain_per_s": 22.0
}  # fmt: skip

PRESETS: Mapping[str, dict[str, Any]] = MappingProxyType({"paper": PAPER, "tuned": TUNED, "robust": ROBUST})
"""For each preset, the settings that differ from the defaults."""
