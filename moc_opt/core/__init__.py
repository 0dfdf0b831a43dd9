"""The tick in C: arm, law, subproblem, `exact`, the network, the safety filter. `moc.h` is where to begin.

`plan.h` and `plant.h` are what planning and the simulated plant need of it. The binding (`python.c`, `tools.c`) checks
every array (float64, C-contiguous, its shape) and raises ValueError or TypeError; only a Loader keeps any.
"""

from __future__ import annotations

try:
    from moc_opt.core._core import (
        BAD_Q,
        BAD_V,
        DOUBTFUL,
        INFEASIBLE,
        MAX_JOINTS,
        OK,
        REASONS,
        UNFINISHED,
        Arm,
        Guard,
        Law,
        Loader,
        add_force,
        advance,
        ascend,
        assemble,
        desired_wrist,
        follow_curve,
        judge,
        least_violation,
        onto_curve,
        read_encoders,
        retreat,
        shaft_force,
        solve_exact,
        solve_exact_rows,
        step_network,
    )
except ImportError as error:
    raise ImportError(
        f"moc_opt's compiled core cannot be loaded ({error}): install the package, `pip install .` (or -e .), which "
        "compiles it"
    ) from error

__all__ = [
    "BAD_Q", "BAD_V", "DOUBTFUL", "INFEASIBLE", "MAX_JOINTS", "OK", "REASONS", "UNFINISHED", "Arm", "Guard", "Law",
    "Loader", "add_force", "advance", "ascend", "assemble", "desired_wrist", "follow_curve", "judge",
    "least_violation", "onto_curve", "read_encoders", "retreat", "shaft_force", "solve_exact", "solve_exact_rows",
    "step_network",
]  # fmt: skip
