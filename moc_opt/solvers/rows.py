"""Which equality rows a solver gets: the six of the paper, or five independent ones.

Tip and wrist are rigidly tied, so one of the six rows repeats the others. Many solvers factorise
A P^-1 A^T or pivot on it and fail there; five rows cure them. Either way the duals come back as six:
A5 = lift A6 gives A5^T y5 = A6^T (lift^T y5).
"""

from __future__ import annotations

import numpy as np

from moc_opt.subproblem import NullSpaceQP, Reduced

ROWS = (5, 6)
_SIX = np.eye(6)
_SIX.flags.writeable = False


def equalities(qp: NullSpaceQP, rows: int) -> Reduced:
    """The rows A (m, n), b (m,) and lift (m, 6) in the form that was asked for.

    rows = 5 still gives six where tip and wrist are not rigidly tied.
    """
    return qp.reduced() if rows == 5 else Reduced(qp.A, qp.b, _SIX)
