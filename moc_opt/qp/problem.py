"""The null-space subproblem of one control tick.

    min_x  c0/2 |J_T x - v_T|^2 + c1/2 |J_W x - v_W|^2 - c2 x^T pull + regularization/2 |x|^2
    s.t.   J_T x = v_T,   J_W x = v_W,   lower <= x <= upper

x is a joint velocity [rad/s]. J_T and J_W are the Jacobians of tip and wrist, v_T and v_W their reference velocities.
By default, pull is the gradient of the manipulability mu. The terms with c0 and c1 are zero at every feasible x.
regularization = 0 gives the problem of Su et al. (2019). The six equality rows have rank five if a rigid tool connects
tip and wrist.
"""

from __future__ import annotations

from functools import cache, cached_property
from itertools import accumulate, pairwise
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from moc_opt import core
from moc_opt.arrays import Array, read_only
from moc_opt.errors import SubproblemError, shown
from moc_opt.qp import residuals as optimality
from moc_opt.qp.residuals import Residuals

LARGEST_WEIGHT = 1e12
REGULARIZATION = 1e-5
WEIGHTS = ("c0", "c1", "c2", "regularization")
ROWS = (5, 6)  #: Numbers of equality rows that a solver may ask for.
_DOUBLE, _CONTIGUOUS = np.dtype(np.float64), (8,)


def row_length(n: int) -> int:
    """Return the length of the flat array (see `Fields`) of a subproblem with n joints."""
    return 11 * n + 10


def joints_of(length: int) -> int:
    """Return the number of joints from the length of the flat array."""
    return (length - 10) // 11


class Fields(NamedTuple):
    """Views of the parts of a flat array (..., 11 n + 10)."""

    A: Array  # (..., 6, n) = [J_tip; J_wrist]
    b: Array  # (..., 6) = [v_tip; v_wrist]
    grad_mu: Array  # (..., n)
    pull: Array  # (..., n)
    lower: Array  # (..., n)
    upper: Array  # (..., n)
    weights: Array  # (..., 4) = c0, c1, c2, regularization
    q: Array  # (..., n), the joint position; NaN if it was not given


def fields(rows: Array) -> Fields:
    """Split the flat array of one subproblem, or of a batch, into named views."""
    n = joints_of(rows.shape[-1])
    if n < 1 or row_length(n) != rows.shape[-1]:
        raise SubproblemError(f"row: length {rows.shape[-1]} is not 11 n + 10; use NullSpaceQP(...).row")
    one = rows.ndim == 1  # indexing without an ellipsis is faster
    A, *parts = (rows[place] if one else rows[..., place] for place in _places(n))
    return Fields(A.reshape(*rows.shape[:-1], 6, n), *parts)


@cache
def _places(n: int) -> tuple[slice, ...]:
    return tuple(slice(*ends) for ends in pairwise(accumulate((0, 6 * n, 6, n, n, n, n, 4, n))))


def compute_residuals(rows: Array, x: Array, y: Array | None = None) -> Residuals:
    """Return the residuals of answers x (k, n), y (k, 6) to the subproblems ``rows`` (k, 11 n + 10)."""
    part = fields(rows)
    problem = optimality.Problem(part.A, part.b, part.pull, part.lower, part.upper, part.weights)
    return optimality.residuals(problem, x, y)


class Assembled(NamedTuple):
    """Read-only arrays of min 1/2 x^T P x + p^T x s.t. A x = b, with m = 5 or 6 rows. lift^T maps m duals to six."""

    P: Array  #: (n, n)
    p: Array  #: (n,)
    A: Array  #: (m, n)
    b: Array  #: (m,)
    lift: Array  #: (m, 6)


class NullSpaceQP:
    """One subproblem, with validated, read-only arrays.

    Args:
        J_tip, J_wrist: (3, n) translational Jacobians in world axes [m/rad].
        v_tip, v_wrist: (3,) reference velocities [m/s], with equal components along the shaft.
        grad_mu: (n,) gradient of the manipulability.
        lower, upper: (n,) bounds on the joint velocity [rad/s].
        c0, c1, c2, regularization: weights in the cost.
        q: (n,) joint position [rad]; only the nonlinear solvers need it.
        pull: (n,) vector in the cost, by default grad_mu.

    Raises:
        SubproblemError: an argument is invalid.

    Example:
        >>> robot = mo.load_robot("lwr4")
        >>> state = robot.state(robot.data.q_home)
        >>> qp = mo.NullSpaceQP(state.J_tip, state.J_wrist, v_tip=[0.01, 0, 0], v_wrist=[0.01, 0, 0],
        ...                     grad_mu=state.grad_mu, lower=-robot.v_max, upper=robot.v_max)
        >>> qp.A.shape, qp.P.shape, qp.assembled(6).A.shape, qp.reduced().A.shape, qp.copy() == qp
        ((6, 7), (7, 7), (6, 7), (5, 7), True)
        >>> solution = mo.solvers.create("exact").start(qp).solve(qp)
        >>> bool(qp.residuals(solution.x, solution.y).verified()), qp.objective(solution.x) < 0.0
        (True, True)
        >>> mo.NullSpaceQP.from_row(qp.row.copy()) == qp
        True
    """

    row: Array
    n: int

    def __init__(
        self, J_tip: ArrayLike, J_wrist: ArrayLike, v_tip: ArrayLike, v_wrist: ArrayLike, grad_mu: ArrayLike,
        lower: ArrayLike, upper: ArrayLike, c0: float = 0.01, c1: float = 0.01, c2: float = 0.001,
        regularization: float = REGULARIZATION, q: ArrayLike | None = None, pull: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        jacobian = _array("J_tip", J_tip)
        if jacobian.ndim != 2 or jacobian.shape[0] != 3 or jacobian.shape[1] < 1:
            raise SubproblemError(f"J_tip: shape {jacobian.shape} is not (3, n); pass the rows x, y, z in world axes")
        n = jacobian.shape[1]
        low, high = _array("lower", lower, (n,)), _array("upper", upper, (n,))
        gradient, weights = _array("grad_mu", grad_mu, (n,)), []
        for name, value in zip(WEIGHTS, (c0, c1, c2, regularization), strict=True):
            weight = float(_array(name, value, ()))
            if not 0.0 <= weight <= LARGEST_WEIGHT:
                raise SubproblemError(f"{name}: {weight}: give 0 to {LARGEST_WEIGHT:g}; larger weights overflow")
            weights.append(weight)
        crossed = np.flatnonzero(low > high)
        if crossed.size:
            i = int(crossed[0])
            raise SubproblemError(
                f"lower: lower[{i}] = {low[i]} is above upper[{i}] = {high[i]}; swap them, or check that the joint is "
                "inside its limits"
            )
        parts = (
            jacobian.ravel(), _array("J_wrist", J_wrist, (3, n)).ravel(), _array("v_tip", v_tip, (3,)),
            _array("v_wrist", v_wrist, (3,)), gradient, gradient if pull is None else _array("pull", pull, (n,)),
            low, high, weights,
            np.full(n, np.nan) if q is None else _array("q", q, (n,)),
        )  # fmt: skip
        self._adopt(np.concatenate(parts), n)

    @classmethod
    def from_row(cls, row: Array) -> NullSpaceQP:
        """Wrap the `row` of a subproblem without check or copy. The array becomes read-only."""
        self = object.__new__(cls)
        self._adopt(row, joints_of(row.shape[0]))
        return self

    def copy(self) -> NullSpaceQP:
        """Return a copy."""
        return NullSpaceQP.from_row(self.row.copy())

    def _adopt(self, row: Array, n: int) -> None:
        if row.strides != _CONTIGUOUS or row.dtype is not _DOUBLE:  # the compiled core needs contiguous doubles
            row = np.array(row, dtype=np.float64).ravel()
        row.setflags(write=False)
        own = self.__dict__  # bypasses __setattr__
        own["row"], own["n"] = row, n

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"NullSpaceQP is frozen: make a new one to change {name}")

    def __reduce__(self) -> tuple[Any, ...]:
        return NullSpaceQP.from_row, (np.array(self.row),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, NullSpaceQP) and np.array_equal(self.row, other.row, equal_nan=True)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        c0, c1, c2, regularization = self.fields.weights
        return f"NullSpaceQP(n={self.n}, c0={c0:g}, c1={c1:g}, c2={c2:g}, regularization={regularization:g})"

    @cached_property
    def fields(self) -> Fields:
        """Read-only views of all parts of `row`."""
        return fields(self.row)

    J_tip = property(lambda self: self.fields.A[:3], doc="(3, n) [m/rad]")
    J_wrist = property(lambda self: self.fields.A[3:], doc="(3, n) [m/rad]")
    v_tip = property(lambda self: self.fields.b[:3], doc="(3,) [m/s]")
    v_wrist = property(lambda self: self.fields.b[3:], doc="(3,) [m/s]")
    grad_mu = property(lambda self: self.fields.grad_mu, doc="(n,) gradient of mu")
    pull = property(lambda self: self.fields.pull, doc="(n,) vector in the cost, by default grad_mu")
    lower = property(lambda self: self.fields.lower, doc="(n,) [rad/s]")
    upper = property(lambda self: self.fields.upper, doc="(n,) [rad/s]")
    c0 = property(lambda self: float(self.fields.weights[0]), doc="weight of the tip rows")
    c1 = property(lambda self: float(self.fields.weights[1]), doc="weight of the wrist rows")
    c2 = property(lambda self: float(self.fields.weights[2]), doc="weight of the manipulability")
    regularization = property(lambda self: float(self.fields.weights[3]), doc="rho, the weight of |x|^2")
    A = property(lambda self: self.fields.A, doc="(6, n): J_tip above J_wrist")
    b = property(lambda self: self.fields.b, doc="(6,): v_tip above v_wrist")

    @property
    def q(self) -> Array | None:
        """(n,) joint position [rad], or None if it was not given."""
        return None if np.isnan(self.fields.q[0]) else self.fields.q

    P = property(lambda self: self.reduced().P, doc="(n, n): c0 J_T^T J_T + c1 J_W^T J_W + regularization I")
    p = property(lambda self: self.reduced().p, doc="(n,): -c0 J_T^T v_T - c1 J_W^T v_W - c2 pull")

    def objective(self, x: ArrayLike) -> float:
        """Return 1/2 x^T P x + p^T x, the cost without its constant term.

        Raises:
            SubproblemError: x is not (n,) numbers.
        """
        x = _array("x", x, (self.n,), finite=False)
        return float(0.5 * x @ self.P @ x + self.p @ x)

    def assembled(self, rows: int = 5) -> Assembled:
        """Compute cost and equality rows. With ``rows`` = 5 and a rigid tool, two rows replace the wrist's three."""
        n = self.n
        P, p, spare, plain = np.empty((n, n)), np.empty(n), np.empty(n), np.ones(3)
        for m in (rows, 6):
            A, b, lift = np.empty((m, n)), np.empty(m), np.empty((m, 6))
            if core.load(self.row, rows == 5, 1.0, plain, P, p, A, b, b, spare, spare, np.empty(0), lift):
                break
        return Assembled(*(read_only(part) for part in (P, p, A, b, lift)))

    @cached_property
    def _reduced(self) -> Assembled:
        return self.assembled()

    def reduced(self) -> Assembled:
        """Return `assembled()`, which is computed only once."""
        return self._reduced

    def residuals(self, x: ArrayLike, y: ArrayLike | None = None) -> Residuals:
        """Compute the residuals of an answer x (n,) and its duals y (6,).

        Raises:
            SubproblemError: a shape is wrong.
        """
        x = _array("x", x, (self.n,), finite=False)
        duals = None if y is None else _array("y", y, (6,), "; lift five duals with reduced().lift.T", finite=False)
        found = compute_residuals(self.row, x, duals)
        return Residuals(*(float(f) for f in found))  # type: ignore[arg-type]


def _array(
    name: str, value: ArrayLike, shape: tuple[int, ...] | None = None, cure: str = "", finite: bool = True
) -> Array:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise SubproblemError(f"{name}: {shown(value)} is not an array of numbers") from error
    if shape is not None and array.shape != shape:
        raise SubproblemError(f"{name}: shape {array.shape} is not {shape}{cure}")
    if finite and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise SubproblemError(f"{name}: entry {where} is {array[where]}; every entry must be finite")
    return array
