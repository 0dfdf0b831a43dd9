"""One control period in C: arm, control law, subproblem, solver `exact`, neural network, safety filter.

Read `moc.h` first. `tools.h` declares the functions that only Python calls. `arguments.c`, `python*.c` and `plant.c`
are the Python binding. It raises ValueError or TypeError unless arrays are C-contiguous float64 of the right shape.
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
