"""Base of the adapters of QP libraries: settings, buffers, number of equality rows, scaling of cost and duals.

An adapter is one file with two classes: a frozen dataclass of the library's settings, derived from `Adapter`, and a
subclass of `LibrarySession`. See docs/extending.md; ``piqp`` is a short example.

The libraries need the same numbers in different layouts: stacked rows, columns, a packed triangle, other signs. One
call of the compiled core writes a layout in a microsecond. Numpy would take as long as the fastest library's solve.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sparse

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.qp.problem import ROWS, NullSpaceQP
from moc_opt.solvers.base import Choices, Solution, SolverSettings, Status, no_answer

Outcome = tuple[Status, int, Array, Array]
_HAS_X = (Status.SOLVED, Status.MAX_ITER, Status.TIME_LIMIT)


class Adapter(SolverSettings):
    """Base of a library's settings, which are a frozen dataclass with at least ``cost_scale``.

    Attributes:
        rows: number of equality rows, 5 or 6. It is a setting only if the library can handle six dependent rows.
        cost_scale: multiplies P and p; the duals are scaled back.
        needs: message for a cost that is not positive definite; empty if the library accepts such a cost.
    """

    rows: int = 5
    cost_scale: float
    choices: ClassVar[Choices] = {"rows": ROWS}
    needs: ClassVar[str] = ""

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None if the library accepts the subproblem, else the reason why not."""
        return refuse_semidefinite(qp, self.needs) if self.needs else None


def refuse_semidefinite(qp: NullSpaceQP, needs: str) -> str | None:
    """Return why ``qp`` is refused by a library that needs a positive definite cost; None if it is accepted."""
    why = f"{needs}, and regularization is {qp.regularization:g}: set regularization > 0"
    return None if qp.regularization > 1e-10 * (qp.c0 + qp.c1) else why


class LibrarySession(ABC):
    """One workspace of a library, and the buffers that the library reads."""

    dual_sign: ClassVar[float] = 1.0  #: -1.0 if the library's multipliers of A x = b are -`Solution.y`, else 1.0.

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._factor = self.dual_sign / settings.cost_scale
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        rows, scale = self._settings.rows, self._settings.cost_scale
        self._m, self._n = m, n = qp.assembled(rows).A.shape
        into = {"packed": np.empty(0), "signs": (1.0, 1.0, 1.0), **self._allocate(m, n)}
        buffers = [into[name] for name in ("P", "p", "A", "low", "high", "lower", "upper", "packed")]
        self._lift = np.empty((m, 6))
        self._to = rows == 5, scale, np.array(into["signs"]), *buffers, self._lift
        self._load(qp)
        self._set_up(m, n)

    @abstractmethod
    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        """Return the buffers by name. Each is an array that the library reads, or a view into such an array.

        P (n, n) and p (n,) receive the cost times ``cost_scale``, A (m, n) the equality rows, low (m,) and high (m,)
        their right-hand sides, lower (n,) and upper (n,) the bounds. Optional: ``packed`` (n (n + 1) / 2,), the upper
        triangle of P by columns, and ``signs``, three factors for p, lower and upper.
        """

    def _load(self, qp: NullSpaceQP) -> bool:
        """Write ``qp`` into the buffers and return True. If its shape is not that of the buffers, only return False."""
        return qp.n == self._n and core.load(qp.row, *self._to)

    def _set_up(self, m: int, n: int) -> None:  # noqa: B027
        """Create the library's workspace from the loaded arrays, and set its options."""

    def _hand_over(self) -> None:  # noqa: B027
        """Pass the loaded arrays to the library."""

    @abstractmethod
    def _run(self) -> Outcome:
        """Run the library. Return the status, iterations, x (n,) and the multipliers (m,) of A x = b.

        The next run must not overwrite x. x and the multipliers are used only if the status is one of `_HAS_X`.
        """

    def update(self, qp: NullSpaceQP) -> None:
        """Pass the subproblem to the library. If its shape has changed, create a new workspace first."""
        if not self._load(qp):
            self._build(qp)
        self._hand_over()

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem."""
        if self._settings.needs and self._settings.supports(qp) is not None:
            return no_answer(qp.n, Status.UNSUPPORTED)
        self.update(qp)
        status, iterations, x, y = self._run()
        if status not in _HAS_X:
            return no_answer(qp.n, status, iterations)
        return Solution(x, self._factor * (y @ self._lift), status, iterations)


class TruncatedSession(LibrarySession):
    """A session of a library whose limit of iterations can be changed between solves."""

    @abstractmethod
    def _limit(self, iterations: int) -> None:
        """Set the library's largest number of iterations."""

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """Return the iterate after ``iterations`` (at least 1). They begin where the previous solve began."""
        self._limit(iterations)
        try:
            return self.solve(qp)
        finally:
            self._limit(self._settings.max_iter)


def upper_triangle(values: Array, n: int) -> sparse.csc_matrix:
    """Wrap (n (n + 1) / 2,) values, by columns, as the upper triangle of an (n, n) matrix. Zeros are kept."""
    rows = np.concatenate([np.arange(j + 1) for j in range(n)])
    return sparse.csc_matrix((values, rows, np.cumsum(np.arange(n + 1))), shape=(n, n))


def stacked(values: Array, boxes: int) -> sparse.csc_matrix:
    """Return a matrix of m dense rows above ``boxes`` diagonal blocks. Column j is in row j of ``values``."""
    n, m = len(values), values.shape[1] - boxes
    rows = np.concatenate([np.append(np.arange(m), m + n * np.arange(boxes) + j) for j in range(n)])
    return sparse.csc_matrix((values.ravel(), rows, (m + boxes) * np.arange(n + 1)), shape=(m + boxes * n, n))
