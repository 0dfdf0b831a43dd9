"""One control period in C: arm, control law, subproblem, solver `exact`, neural network, safety filter.

Read `moc.h` first. Calls from Python raise ValueError or TypeError unless arrays are C-contiguous float64.
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
        f"moc_opt's compiled core cannot be loaded ({error}): install the package with `pip install .` (or "
        "`pip install -e .`), which compiles the core"
    ) from error

__all__ = [
    "DOUBTFUL", "INFEASIBLE", "MAX_JOINTS", "OK", "REASONS", "UNFINISHED", "Arm", "Guard", "Law",
    "advance", "desired_wrist", "load", "read_encoders", "shaft_wrench", "solve_exact", "solve_exact_rows",
    "step_network",
]  # fmt: skip
