"""How much longer each solver takes for an arm with more joints: smooth sequences of random arms."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from benchmarks.solver_study.answers import Data, recorded
from benchmarks.subproblems.arms import random_arm, smooth_sequence
from moc_opt.figures.notation import Doubtful

COUNT = 32
SEED = 5


def kinematics(n: int) -> Any:
    """Return CasADi functions of the arm with n joints."""
    return _arm(n).kinematics()


def sequence(n: int, count: int = COUNT) -> Data:
    """Make ``count`` subproblems of one arm with n joints, 2 ms apart; the arm moves like that: all are feasible."""
    problems = smooth_sequence(np.random.default_rng([SEED, n, 1]), count, arm=_arm(n))
    return recorded(f"n={n}", problems, partial(kinematics, n))


def _arm(n: int) -> Any:
    return random_arm(np.random.default_rng([SEED, n]), n, structured=False)


def growth(times: Mapping[int, Mapping[str, float]], key: str = "solve_p50_us") -> dict[str, float]:
    """Fit from joints -> figures the {exponent of n, ratio of the last to the first}; empty with fewer than two.

    Times that are not to be trusted are left out.
    The exponent is the slope of a straight line through log time over log n.
    """
    joints = sorted(n for n, found in times.items() if found.get(key) and not isinstance(found[key], Doubtful))
    if len(joints) < 2:
        return {}
    values = np.array([times[n][key] for n in joints])
    slope = float(np.polyfit(np.log(joints), np.log(values), 1)[0])
    return {"exponent": slope, f"{joints[-1]}_over_{joints[0]}": float(values[-1] / values[0])}
