"""The libraries behind our adapters, driven by hand: what a careful user would write without this package.

Each class sets its library up once; ``load`` puts the numbers of a subproblem into buffers of its own, ``solve`` is
the library's part alone and returns x and the multipliers of the rows as the library gives them. Calling the object
does both. Settings are those of our adapter, so that both do the same work. No status is translated, no dual lifted,
nothing checked: that is what an adapter may cost.

A new one: a class with these three methods, one line in ``BARE``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP


class Bare(Protocol):
    """A library set up for one stream of subproblems."""

    def load(self, qp: NullSpaceQP) -> None:
        """Put the numbers of ``qp`` where the library reads them."""
        ...

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        """Return x (n,) and the multipliers of the rows, for what was loaded."""
        ...

    def __call__(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        """Load and solve."""
        ...


class _Library:
    """Load, then solve."""

    load: Callable[[NullSpaceQP], None]
    solve: Callable[[NullSpaceQP], tuple[Array, Array]]

    def __call__(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        self.load(qp)
        return self.solve(qp)


class BareOSQP(_Library):
    """osqp's own extension: update_data_vec, update_data_mat, solve."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        import scipy.sparse as sparse
        from osqp import ext_builtin as core

        m, n = self._shape = qp.reduced().A.shape
        self._scale = settings.cost_scale
        self._upper = np.concatenate([np.arange(j + 1) * n + j for j in range(n)])
        self._P, self._q = np.empty(len(self._upper)), np.empty(n)
        self._A, self._l, self._u = np.ones((n, m + 1)), np.empty(m + n), np.empty(m + n)
        self.load(qp)
        P = sparse.csc_matrix((self._P, self._upper // n, np.cumsum(np.arange(n + 1))), shape=(n, n))
        below = np.concatenate([np.append(np.arange(m), m + j) for j in range(n)])
        A = sparse.csc_matrix((self._A.ravel(), below, (m + 1) * np.arange(n + 1)), shape=(m + n, n))
        options = core.OSQPSettings()
        core.osqp_set_default_settings(options)
        options.verbose, options.max_iter, options.polishing = 0, settings.max_iter, int(settings.polishing)
        options.eps_abs, options.eps_rel = settings.eps, settings.eps_rel
        options.check_termination = settings.check_termination
        matrices = (core.CSC(P), self._q, core.CSC(A), self._l, self._u)
        self._core: Any = core.OSQPSolver(*matrices, m + n, n, options)

    def load(self, qp: NullSpaceQP) -> None:
        (m, _), (A, b, _), part = self._shape, qp.reduced(), qp.fields
        qp.P.take(self._upper, out=self._P)
        self._P *= self._scale
        np.multiply(qp.p, self._scale, out=self._q)
        self._A[:, :m] = A.T
        self._l[:m] = self._u[:m] = b
        self._l[m:], self._u[m:] = part.lower, part.upper

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        core = self._core
        core.update_data_vec(q=self._q, l=self._l, u=self._u)
        core.update_data_mat(P_x=self._P, P_i=None, A_x=self._A.reshape(-1), A_i=None)
        core.solve()
        found = core.solution
        return np.array(found.x), found.y[: self._shape[0]]


class BareProxQP(_Library):
    """proxsuite's dense QP: update, solve."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        from proxsuite import proxqp

        m, n = qp.reduced().A.shape
        self._scale = settings.cost_scale
        self._P, self._p = np.empty((n, n)), np.empty(n)
        self._core = core = proxqp.dense.QP(n, m, 0, True)
        options = core.settings
        options.eps_abs, options.eps_rel = settings.eps, 0.0
        options.eps_primal_inf = settings.eps_primal_inf
        options.max_iter, options.max_iter_in = settings.max_iter, settings.max_iter_in
        options.initial_guess = proxqp.InitialGuess.COLD_START_WITH_PREVIOUS_RESULT
        A, b, _ = qp.reduced()
        self.load(qp)
        core.init(self._P, self._p, A, b, None, None, None, qp.lower, qp.upper)

    def load(self, qp: NullSpaceQP) -> None:
        np.multiply(qp.P, self._scale, out=self._P)
        np.multiply(qp.p, self._scale, out=self._p)

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        (A, b, _), part, core = qp.reduced(), qp.fields, self._core
        core.update(self._P, self._p, A, b, None, None, None, part.lower, part.upper)
        core.solve()
        result = core.results
        return np.array(result.x), result.y


class BareDAQP(_Library):
    """daqp.Model: update, solve."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        from daqp import Model

        m, n = self._shape = qp.reduced().A.shape
        self._scale = settings.cost_scale
        self._P, self._p, self._A = np.empty((n, n)), np.empty(n), np.empty((m, n))
        self._lower, self._upper = np.empty(n + m), np.empty(n + m)
        sense = np.concatenate([np.zeros(n, dtype=np.int32), np.full(m, 5, dtype=np.int32)])  # 5: equality
        self.load(qp)
        self._core = Model()
        self._core.settings = {
            "primal_tol": settings.primal_tol, "dual_tol": settings.dual_tol, "iter_limit": settings.max_iter,
        }  # fmt: skip
        self._core.setup(self._P, self._p, self._A, self._upper, self._lower, sense)

    def load(self, qp: NullSpaceQP) -> None:
        (_, n), (A, b, _), part = self._shape, qp.reduced(), qp.fields
        np.multiply(qp.P, self._scale, out=self._P)
        np.multiply(qp.p, self._scale, out=self._p)
        self._A[:] = A
        self._lower[:n], self._upper[:n] = part.lower, part.upper
        self._lower[n:] = self._upper[n:] = b

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        self._core.update(self._P, self._p, self._A, self._upper, self._lower, None)
        x, _, _, info = self._core.solve()
        return x, info["lam"][self._shape[1] :]


class BarePIQP(_Library):
    """piqp.DenseSolver: update, solve."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        import piqp

        m, n = qp.reduced().A.shape
        self._scale = settings.cost_scale
        self._P, self._p, self._A = np.empty((n, n), order="F"), np.empty(n), np.empty((m, n), order="F")
        self._core = core = piqp.DenseSolver()
        core.settings.eps_abs, core.settings.eps_rel = settings.eps, 0.0
        core.settings.eps_duality_gap_abs, core.settings.eps_duality_gap_rel = settings.eps, 0.0
        core.settings.max_iter = settings.max_iter
        self.load(qp)
        core.setup(self._P, self._p, self._A, qp.reduced().b, None, None, None, qp.lower, qp.upper)

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


class BareQuadprog(_Library):
    """quadprog.solve_qp: one function that keeps nothing."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        from quadprog import solve_qp

        m, n = self._shape = qp.reduced().A.shape
        self._scale, self._solve = settings.cost_scale, solve_qp
        self._C, self._b = np.zeros((n, m + 2 * n), order="F"), np.empty(m + 2 * n)
        self._C[:, m : m + n], self._C[:, m + n :] = np.eye(n), -np.eye(n)
        self._P, self._a = np.empty((n, n), order="F"), np.empty(n)

    def load(self, qp: NullSpaceQP) -> None:
        (m, n), (A, b, _), part = self._shape, qp.reduced(), qp.fields
        np.multiply(qp.P, self._scale, out=self._P)
        np.multiply(qp.p, -self._scale, out=self._a)
        self._C[:, :m] = A.T
        self._b[:m], self._b[m : m + n] = b, part.lower
        np.negative(part.upper, out=self._b[m + n :])

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        m = self._shape[0]
        x, _, _, _, multipliers, _ = self._solve(self._P, self._a, self._C, self._b, m)
        return x, multipliers[:m]


class BareClarabel(_Library):
    """clarabel.DefaultSolver: update, solve."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        import clarabel
        import scipy.sparse as sparse

        m, n = self._shape = qp.reduced().A.shape
        self._scale = settings.cost_scale
        self._upper = np.concatenate([np.arange(j + 1) * n + j for j in range(n)])
        self._P, self._q, self._b = np.empty(len(self._upper)), np.empty(n), np.empty(m + 2 * n)
        self._A = np.ones((n, m + 2))
        self._A[:, m + 1] = -1.0
        self.load(qp)
        P = sparse.csc_matrix((self._P, self._upper // n, np.cumsum(np.arange(n + 1))), shape=(n, n))
        below = np.concatenate([np.append(np.arange(m), [m + j, m + n + j]) for j in range(n)])
        A = sparse.csc_matrix((self._A.ravel(), below, (m + 2) * np.arange(n + 1)), shape=(m + 2 * n, n))
        options = clarabel.DefaultSettings()
        options.verbose, options.presolve_enable, options.max_threads = False, False, 1
        options.tol_feas = options.tol_gap_abs = options.tol_gap_rel = settings.eps
        options.max_iter = settings.max_iter
        cones = [clarabel.ZeroConeT(m), clarabel.NonnegativeConeT(2 * n)]
        self._core: Any = clarabel.DefaultSolver(P, self._q, A, self._b, cones, options)

    def load(self, qp: NullSpaceQP) -> None:
        (m, n), (A, b, _), part = self._shape, qp.reduced(), qp.fields
        qp.P.take(self._upper, out=self._P)
        self._P *= self._scale
        np.multiply(qp.p, self._scale, out=self._q)
        self._A[:, :m] = A.T
        self._b[:m], self._b[m : m + n] = b, part.upper
        np.negative(part.lower, out=self._b[m + n :])

    def solve(self, qp: NullSpaceQP) -> tuple[Array, Array]:
        self._core.update(P=self._P, q=self._q, A=self._A.ravel(), b=self._b)
        found = self._core.solve()
        return np.array(found.x), np.array(found.z[: self._shape[0]])


BARE: dict[str, Callable[[Any, NullSpaceQP], Bare]] = {
    "osqp": BareOSQP,
    "proxqp": BareProxQP,
    "daqp": BareDAQP,
    "piqp": BarePIQP,
    "quadprog": BareQuadprog,
    "clarabel": BareClarabel,
}
"""Name of an adapter -> the same library by hand, made from the adapter's settings and a first subproblem."""
