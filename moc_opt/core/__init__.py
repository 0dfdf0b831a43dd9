"""The tick in C: arm, law, subproblem, `exact`, the network, the safety filter. Begin with `moc.h`.

`tools.h` declares functions for Python outside the controller. The binding (`arguments.c`, `python*.c`, `plant.c`)
checks every array (float64, C-contiguous, its shape), raises ValueError or TypeError, and keeps no array.
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
