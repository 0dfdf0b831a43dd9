"""The libraries behind our adapters, driven by hand, as a careful user would without this package.

Each class takes the workspace that our adapter has set up, options and buffers included, so that both do the same
work. ``load`` puts the numbers of a subproblem into the buffers with numpy alone, ``solve`` is the library's part alone
and returns x and the multipliers of the rows as the library gives them. Calling the object does both. No status is
translated, no dual lifted, nothing checked: that is what an adapter may cost.

A new one: a class with these two methods, one line in ``BARE``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP


class Bare(ABC):
    """A library set up for one stream of subproblems.

    Args:
        settings: an adapter's; with warm starts, as it comes.
        qp: gives shape and first numbers.
    """

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        self._at: Any = settings.start(qp)
        self._core: Any = getattr(self._at, "_core", None)
        (self._m, self._n), self._scale = qp.reduced().A.shape, settings.cost_scale
        self._triangle = np.concatenate([np.arange(j + 1) * self._n + j for j in range(self._n)])

    @abstractmethod
    def load(self, qp: NullSpaceQP) -> None:
        """Put the numbers of ``qp`` where the library reads them."""

    @abstractmethod
    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        """Return x (n,) and the multipliers of the rows, for what was loaded."""

    def __call__(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        """Load and solve."""
        self.load(qp)
        return self.solve(qp)


class BareOSQP(Bare):
    """osqp's own extension: update_data_vec, update_data_mat, solve."""

    def load(self, qp: NullSpaceQP) -> None:
        m, (A, b, _), part, at = self._m, qp.reduced(), qp.fields, self._at
        qp.P.take(self._triangle, out=at._P)
        at._P *= self._scale
        np.multiply(qp.p, self._scale, out=at._q)
        at._A[:, :m] = A.T
        at._l[:m] = at._u[:m] = b
        at._l[m:], at._u[m:] = part.lower, part.upper

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        core, at = self._core, self._at
        core.update_data_vec(q=at._q, l=at._l, u=at._u)
        core.update_data_mat(P_x=at._P, P_i=None, A_x=at._A.reshape(-1), A_i=None)
        core.solve()
        found = core.solution
        return np.array(found.x), found.y[: self._m]


class BareProxQP(Bare):
    """proxsuite's dense QP: update, solve."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        super().__init__(settings, qp)
        self._at._guess(True)
        self._P, self._p = self._at._data[:2]

    def load(self, qp: NullSpaceQP) -> None:
        np.multiply(qp.P, self._scale, out=self._P)
        np.multiply(qp.p, self._scale, out=self._p)

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        (A, b, _), part, core = qp.reduced(), qp.fields, self._core
        core.update(self._P, self._p, A, b, None, None, None, part.lower, part.upper)
        core.solve()
        result = core.results
        return np.array(result.x), result.y


class BareDAQP(Bare):
    """daqp.Model: update, solve."""

    def load(self, qp: NullSpaceQP) -> None:
        n, (A, b, _), part, at = self._n, qp.reduced(), qp.fields, self._at
        np.multiply(qp.P, self._scale, out=at._P)
        np.multiply(qp.p, self._scale, out=at._p)
        at._A[:] = A
        at._lower[:n], at._upper[:n] = part.lower, part.upper
        at._lower[n:] = at._upper[n:] = b

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        at = self._at
        self._core.update(at._P, at._p, at._A, at._upper, at._lower, None)
        x, _, _, info = self._core.solve()
        return x, info["lam"][self._n :]


class BarePIQP(Bare):
    """piqp.DenseSolver: update, solve."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        super().__init__(settings, qp)
        self._P, self._p, self._A = self._at._data[:3]

    def load(self, qp: NullSpaceQP) -> None:
        np.multiply(qp.P, self._scale, out=self._P)
        np.multiply(qp.p, self._scale, out=self._p)
        self._A[:] = qp.reduced().A

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        b, part, core = qp.reduced().b, qp.fields, self._core
        core.update(self._P, self._p, self._A, b, None, None, None, part.lower, part.upper)
        core.solve()
        result = core.result
        return np.array(result.x), result.y


class BareQuadprog(Bare):
    """quadprog.solve_qp: one function that keeps nothing."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        from quadprog import solve_qp

        super().__init__(settings, qp)
        self._solve = solve_qp

    def load(self, qp: NullSpaceQP) -> None:
        m, n, (A, b, _), part, at = self._m, self._n, qp.reduced(), qp.fields, self._at
        np.multiply(qp.P, self._scale, out=at._P)
        np.multiply(qp.p, -self._scale, out=at._a)
        at._C[:, :m] = A.T
        at._b[:m], at._b[m : m + n] = b, part.lower
        np.negative(part.upper, out=at._b[m + n :])

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        m, at = self._m, self._at
        x, _, _, _, multipliers, _ = self._solve(at._P, at._a, at._C, at._b, m)
        return x, multipliers[:m]


class BareClarabel(Bare):
    """clarabel.DefaultSolver: update, solve."""

    def load(self, qp: NullSpaceQP) -> None:
        m, n, (A, b, _), part, at = self._m, self._n, qp.reduced(), qp.fields, self._at
        qp.P.take(self._triangle, out=at._P)
        at._P *= self._scale
        np.multiply(qp.p, self._scale, out=at._q)
        at._A[:, :m] = A.T
        at._b[:m], at._b[m : m + n] = b, part.upper
        np.negative(part.lower, out=at._b[m + n :])

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        at = self._at
        self._core.update(P=at._P, q=at._q, A=at._A.ravel(), b=at._b)
        found = self._core.solve()
        return np.array(found.x), np.array(found.z[: self._m])


BARE: dict[str, type[Bare]] = {
    "osqp": BareOSQP, "proxqp": BareProxQP, "daqp": BareDAQP, "piqp": BarePIQP, "quadprog": BareQuadprog,
    "clarabel": BareClarabel,
}  # fmt: skip
"""Name of an adapter -> the same library by hand, made from the adapter's settings and a first subproblem."""
