"""The equality rows that a solver gets, the six of the paper or five independent ones, and its cost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moc_opt import core
from moc_opt.arrays import Array, read_only
from moc_opt.qp.problem import NullSpaceQP

ROWS = (5, 6)


class Assembled(NamedTuple):
    """A subproblem as a solver takes it: 1/2 x^T P x + p^T x, A x = b, and y6 = lift^T y."""

    P: Array  #: (n, n)
    p: Array  #: (n,)
    A: Array  #: (m, n)
    b: Array  #: (m,)
    lift: Array  #: (m, 6)


def assembled(qp: NullSpaceQP, rows: int = 5) -> Assembled:
    """Compute cost and equality rows of ``qp`` in the form that was asked for; read-only arrays.

    rows = 5 still gives six where tip and wrist are not rigidly tied.
    """
    n = qp.n
    P, p, spare, plain = np.empty((n, n)), np.empty(n), np.empty(n), np.ones(3)
    for m in (rows, 6):
        A, b, lift = np.empty((m, n)), np.empty(m), np.empty((m, 6))
        if core.load(qp.row, rows == 5, 1.0, plain, P, p, A, b, b, spare, spare, np.empty(0), lift):
            break
    return Assembled(*(read_only(part) for part in (P, p, A, b, lift)))
