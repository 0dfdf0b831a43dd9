"""The tick in C: arm, law, subproblem, `exact`, the network, the safety filter. `moc.h` is where to begin.

`tools.h` has what Python needs beside the controller. The binding (`arguments.c`, `python*.c`, `plant.c`) checks every
array (float64, C-contiguous, its shape) and raises ValueError or TypeError; it keeps none of them.
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
