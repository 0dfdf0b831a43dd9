"""From the record of a subproblem into a library's own buffers, in one compiled call.

Every library wants the same numbers in another place: stacked rows, columns, a packed triangle, a negated side. The
call costs a microsecond; the same steps in numpy, one by one, cost as much as the fastest of the libraries itself.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from numba import float64, int64, typeof

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import MATRIX, VECTOR, CompiledKernel
from moc_opt.qp.equalities import assemble, assembled, offsets
from moc_opt.qp.problem import NullSpaceQP


@njit(cache=True, nogil=True)
def load_record(
    row: Array,
    n: int,
    scale: float,
    signs: Array,
    P: Array,
    packed: Array,
    p: Array,
    A: Array,
    low: Array,
    high: Array,
    lower: Array,
    upper: Array,
    lift: Array,
) -> bool:
    """Fill the buffers of a `Loader` from one flat record; False where it has no five rows."""
    if not assemble(row, n, P, p, A, low, lift):
        return False
    at = offsets(n)
    k = 0
    for i in range(n):
        for j in range(n):
            P[i, j] *= scale
        p[i] *= scale * signs[0]
        lower[i] = signs[1] * row[at.lower + i]
        upper[i] = signs[2] * row[at.upper + i]
    for i in range(5):
        high[i] = low[i]
    if packed.shape[0] > 0:
        for j in range(n):
            for i in range(j + 1):
                packed[k] = P[i, j]
                k += 1
    return True


@njit(cache=True, nogil=True)
def lift_duals(lift: Array, y: Array, factor: float, six: Array) -> None:
    """Compute six = factor lift^T y: the multipliers of the six rows (6,) from those of a library's (m,)."""
    for j in range(6):
        total = 0.0
        for i in range(lift.shape[0]):
            total += lift[i, j] * y[i]
        six[j] = factor * total


_LIFT_DUALS = CompiledKernel(lift_duals, MATRIX, VECTOR, float64, VECTOR)


def upper_triangle(values: Array, n: int) -> sparse.csc_matrix:
    """Wrap (n (n + 1) / 2,) values, column by column, as the upper triangle of an (n, n) matrix; zeros stay."""
    rows = np.concatenate([np.arange(j + 1) for j in range(n)])
    return sparse.csc_matrix((values, rows, np.cumsum(np.arange(n + 1))), shape=(n, n))


class Loader:
    """Writes subproblems of one shape into given buffers; each is an array of the library's, or a view into one.

    Args:
        rows: 5 or 6, as the solver's setting asks for.
        scale: multiplies P and p.
        P: (n, n).
        p: (n,).
        A: (m, n) equality rows, m as `equalities` has them.
        low, high: (m,) both sides of the rows; the same array where there is one.
        lower, upper: (n,) the box.
        packed: (n (n + 1) / 2,) upper triangle of P by columns, where that is wanted.
        signs: of p, lower and upper.
    """

    def __init__(
        self,
        rows: int,
        scale: float,
        *,
        P: Array,
        p: Array,
        A: Array,
        low: Array,
        high: Array,
        lower: Array,
        upper: Array,
        packed: Array | None = None,
        signs: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> None:
        self._m, self._n = A.shape
        self._rows, self._scale, self._signs = rows, scale, np.array(signs)
        self._lift = np.zeros((self._m, 6))
        self._packed = np.empty(0) if packed is None else packed
        self._P, self._p, self._A = P, p, A
        self._low, self._high, self._lower, self._upper = low, high, lower, upper
        self._five = rows == 5 and self._m == 5
        targets = (self._signs, P, self._packed, p, A, low, high, lower, upper, self._lift)
        # Each library has its own order of memory: the kernel is compiled for that of these very arrays.
        self._kernel = CompiledKernel(load_record, VECTOR, int64, float64, *map(typeof, targets)).code
        self._targets = (self._n, scale, *targets)
        self._lift_duals = _LIFT_DUALS.code

    def __call__(self, qp: NullSpaceQP) -> bool:
        """Load ``qp``; False where it has another shape, and the buffers hold nothing of use."""
        if self._five:
            return qp.n == self._n and self._kernel(qp.row, *self._targets)
        P, p, A, b, lift = assembled(qp, self._rows)
        if A.shape != (self._m, self._n):
            return False
        self._A[:], self._low[:], self._high[:], self._lift[:] = A, b, b, lift
        np.multiply(P, self._scale, out=self._P)
        np.multiply(p, self._scale * self._signs[0], out=self._p)
        np.multiply(qp.lower, self._signs[1], out=self._lower)
        np.multiply(qp.upper, self._signs[2], out=self._upper)
        if self._packed.size:
            self._packed[:] = self._P.T[np.tril_indices(self._n)]
        return True

    def lifted(self, y: Array, factor: float) -> Array:
        """Return the multipliers of the six rows (6,) from the library's (m,), times ``factor``."""
        six = np.empty(6)  # made here: an array that compiled code makes costs more to hand over
        if y.strides == (8,):
            self._lift_duals(self._lift, y, factor, six)
        else:
            lift_duals(self._lift, y, factor, six)
        return six
