"""The control tick in C: arm, control law, subproblem, solver `exact`, neural network, safety filter. Read moc.h first.

`tools.h` declares functions that only Python calls. The binding (`arguments.c`, `python*.c`, `plant.c`) takes only
arrays of float64 that are C-contiguous of the right shape, else raises ValueError or TypeError. It keeps no array.
"""

from __future__ import annotations

try:
    from moc_opt.core._core import (
        DOUBTFUL,
        INFEASIBLE,
        MAX_JOINTS,
        OK,
        REASONS,
        UNFINISHED,
        Arm,
        Guard,
        Law,
        advance,
        desired_wrist,
        load,
        read_encoders,
        shaft_wrench,
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
    "DOUBTFUL", "INFEASIBLE", "MAX_JOINTS", "OK", "REASONS", "UNFINISHED", "Arm", "Guard", "Law",
    "advance", "desired_wrist", "load", "read_encoders", "shaft_wrench", "solve_exact", "solve_exact_rows",
    "step_network",
]  # fmt: skip
