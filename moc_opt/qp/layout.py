"""Where the parts of a packed subproblem lie: one flat record of 11 n + 10 numbers for n joints.

`moc_opt/core/record.c` reads the same record.
"""

from __future__ import annotations

from typing import NamedTuple

C0, C1, C2, RHO = range(4)  #: Places of the weights: ``record[at.weights + C2]``; rho is the regularization.


class Offsets(NamedTuple):
    """First place of each part in a record; a part ends where the next one begins."""

    A: int  #: (6, n) by rows: J_tip, then J_wrist
    b: int  #: (6,) v_tip, then v_wrist
    grad_mu: int  #: (n,)
    pull: int  #: (n,) what the cost has in place of grad_mu; see `NullSpaceQP`
    lower: int  #: (n,)
    upper: int  #: (n,)
    weights: int  #: (4,) c0, c1, c2, regularization
    q: int  #: (n,), NaN where it was not given
    end: int  #: length of the record


def offsets(n: int) -> Offsets:
    """Compute where the parts of a record with n joints begin."""
    return Offsets(
        0, 6 * n, 6 * n + 6, 7 * n + 6, 8 * n + 6, 9 * n + 6, 10 * n + 6, 10 * n + 10, 11 * n + 10
    )


def joints_of(length: int) -> int:
    """Return how many joints n a record of ``length`` = 11 n + 10 numbers is for."""
    return (length - 10) // 11
