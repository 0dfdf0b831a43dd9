"""The libraries behind our adapters, driven by hand, as a careful user would without this package.

Each is given the workspace that our adapter has set up, options and buffers included, so that both do the same work:
load the numbers, solve, read x (n,) and the multipliers of the rows as the library gives them. No status is translated,
no dual lifted, nothing checked: that is what an adapter may cost.

A new one: a function that returns the call, and its name in ``LIBRARIES``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.qp.problem import NullSpaceQP

Call = Callable[[NullSpaceQP], tuple[Array, Array]]


def by_hand(name: str, settings: Any, qp: NullSpaceQP) -> Call:
    """Return the library of an adapter's settings as one call, for subproblems of the shape of ``qp``."""
    rows, joints = qp.reduced().A.shape
    return LIBRARIES[name](settings.start(qp), settings.cost_scale, rows, joints)


def _osqp(at: Any, scale: float, m: int, n: int) -> Call:
    core, triangle = at._core, _upper_triangle(n)

    def call(qp: NullSpaceQP) -> tuple[Array, Array]:
        (A, b, _), part = qp.reduced(), qp.fields
        qp.P.take(triangle, out=at._P)
        at._P *= scale
        np.multiply(qp.p, scale, out=at._q)
        at._A[:, :m] = A.T
        at._l[:m] = at._u[:m] = b
        at._l[m:], at._u[m:] = part.lower, part.upper
        core.update_data_vec(q=at._q, l=at._l, u=at._u)
        core.update_data_mat(P_x=at._P, P_i=None, A_x=at._A.reshape(-1), A_i=None)
        core.solve()
        found = core.solution
        return np.array(found.x), found.y[:m]

    return call


def _proxqp(at: Any, scale: float, m: int, n: int) -> Call:
    at._guess(True)  # warm
    core, (P, p) = at._core, at._data[:2]

    def call(qp: NullSpaceQP) -> tuple[Array, Array]:
        (A, b, _), part = qp.reduced(), qp.fields
        np.multiply(qp.P, scale, out=P)
        np.multiply(qp.p, scale, out=p)
        core.update(P, p, A, b, None, None, None, part.lower, part.upper)
        core.solve()
        result = core.results
        return np.array(result.x), result.y

    return call


def _daqp(at: Any, scale: float, m: int, n: int) -> Call:
    core = at._core

    def call(qp: NullSpaceQP) -> tuple[Array, Array]:
        (A, b, _), part = qp.reduced(), qp.fields
        np.multiply(qp.P, scale, out=at._P)
        np.multiply(qp.p, scale, out=at._p)
        at._A[:] = A
        at._lower[:n], at._upper[:n] = part.lower, part.upper
        at._lower[n:] = at._upper[n:] = b
        core.update(at._P, at._p, at._A, at._upper, at._lower, None)
        x, _, _, info = core.solve()
        return x, info["lam"][n:]

    return call


def _piqp(at: Any, scale: float, m: int, n: int) -> Call:
    core, (P, p, A) = at._core, at._data[:3]

    def call(qp: NullSpaceQP) -> tuple[Array, Array]:
        (rows, b, _), part = qp.reduced(), qp.fields
        np.multiply(qp.P, scale, out=P)
        np.multiply(qp.p, scale, out=p)
        A[:] = rows
        core.update(P, p, A, b, None, None, None, part.lower, part.upper)
        core.solve()
        result = core.result
        return np.array(result.x), result.y

    return call


def _quadprog(at: Any, scale: float, m: int, n: int) -> Call:
    from quadprog import solve_qp

    def call(qp: NullSpaceQP) -> tuple[Array, Array]:
        (A, b, _), part = qp.reduced(), qp.fields
        np.multiply(qp.P, scale, out=at._P)
        np.multiply(qp.p, -scale, out=at._a)
        at._C[:, :m] = A.T
        at._b[:m], at._b[m : m + n] = b, part.lower
        np.negative(part.upper, out=at._b[m + n :])
        x, _, _, _, multipliers, _ = solve_qp(at._P, at._a, at._C, at._b, m)
        return x, multipliers[:m]

    return call


def _clarabel(at: Any, scale: float, m: int, n: int) -> Call:
    core, triangle = at._core, _upper_triangle(n)

    def call(qp: NullSpaceQP) -> tuple[Array, Array]:
        (A, b, _), part = qp.reduced(), qp.fields
        qp.P.take(triangle, out=at._P)
        at._P *= scale
        np.multiply(qp.p, scale, out=at._q)
        at._A[:, :m] = A.T
        at._b[:m], at._b[m : m + n] = b, part.upper
        np.negative(part.lower, out=at._b[m + n :])
        core.update(P=at._P, q=at._q, A=at._A.ravel(), b=at._b)
        found = core.solve()
        return np.array(found.x), np.array(found.z[:m])

    return call


def _upper_triangle(n: int) -> NDArray[np.intp]:
    return np.concatenate([np.arange(j + 1) * n + j for j in range(n)])


LIBRARIES: dict[str, Callable[[Any, float, int, int], Call]] = {
    "osqp": _osqp, "proxqp": _proxqp, "daqp": _daqp, "piqp": _piqp, "quadprog": _quadprog, "clarabel": _clarabel,
}  # fmt: skip
"""Name of an adapter -> the same library by hand."""
