"""Base classes of the adapters of QP libraries. docs/extending.md explains how to write an adapter."""

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
    """Base of a library's settings.

    Attributes:
        rows: 6 equality rows (tip and wrist), or 5 independent ones.
        cost_scale: factor of P and p. The library's duals are divided by it.
        needs: message of a library that needs a positive definite cost; empty if it accepts any cost.
    """

    rows: int = 5
    cost_scale: float
    choices: ClassVar[Choices] = {"rows": ROWS}
    needs: ClassVar[str] = ""

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return why the library refuses the subproblem, or None."""
        return refuse_semidefinite(qp, self.needs) if self.needs else None


def refuse_semidefinite(qp: NullSpaceQP, needs: str) -> str | None:
    """Return a message that begins with ``needs``, or None if the cost is clearly positive definite."""
    why = f"{needs}, and regularization is {qp.regularization:g}: set regularization > 0"
    return None if qp.regularization > 1e-10 * (qp.c0 + qp.c1) else why


class LibrarySession(ABC):
    """One workspace of a library."""

    dual_sign: ClassVar[float] = 1.0  #: sign of the library's multipliers relative to `Solution.y`

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
        """Return the buffers by name, as docs/extending.md explains."""

    def _load(self, qp: NullSpaceQP) -> bool:
        """Write ``qp`` into the buffers. Return False if the buffers do not fit its size."""
        return qp.n == self._n and core.load(qp.row, *self._to)

    def _set_up(self, m: int, n: int) -> None:  # noqa: B027
        """Create the library's workspace from the loaded arrays."""

    def _hand_over(self) -> None:  # noqa: B027
        """Pass the loaded arrays to the library."""

    @abstractmethod
    def _run(self) -> Outcome:
        """Return status, iterations, x (n,) and multipliers (m,). The next run must not overwrite x."""

    def update(self, qp: NullSpaceQP) -> None:
        """Load a subproblem into the library."""
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
    """A session whose limit of iterations can be changed."""

    @abstractmethod
    def _limit(self, iterations: int) -> None:
        """Limit the iterations of a solve."""

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """Repeat the previous solve from its starting point, with at most ``iterations`` (at least 1)."""
        self._limit(iterations)
        try:
            return self.solve(qp)
        finally:
            self._limit(self._settings.max_iter)


def upper_triangle(values: Array, n: int) -> sparse.csc_matrix:
    """Return a sparse upper triangle (n, n) from its values (n (n + 1) / 2,) by columns. Zeros are stored, too."""
    rows = np.concatenate([np.arange(j + 1) for j in range(n)])
    return sparse.csc_matrix((values, rows, np.cumsum(np.arange(n + 1))), shape=(n, n))


def stacked(values: Array, boxes: int) -> sparse.csc_matrix:
    """Return a sparse matrix of m full rows above ``boxes`` diagonal (n, n) blocks.

    ``values[j]`` (m + boxes,) has the stored entries of column j.
    """
    n, m = len(values), values.shape[1] - boxes
    rows = np.concatenate([np.append(np.arange(m), m + n * np.arange(boxes) + j) for j in range(n)])
    return sparse.csc_matrix((values.ravel(), rows, (m + boxes) * np.arange(n + 1)), shape=(m + boxes * n, n))
