"""The recurrent neural network of Su et al. 2019, equation (2).

x descends the Lagrangian L within the bounds, and the multipliers l1 and l2 ascend it.

    eps dx/dt = -x + clip(x - k (c0 J_T^T (J_T x - v_T) + c1 J_W^T (J_W x - v_W) + rho x - c2 grad_mu
                                 + J_T^T l1 + J_W^T l2), lower, upper)
    eps dl1/dt = k (J_T x - v_T),   eps dl2/dt = k (J_W x - v_W)

`moc_opt/core/rnn.c` makes Euler steps of size h = dt/eps. Here eps is the network's time constant, not the setting
`eps`. v_T and v_W are the velocities that tip and wrist must have. c0, c1, c2 and rho (the regularization) are weights
of the cost, and k is a gain. On infeasible problems, the multipliers grow without bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from moc_opt import core
from moc_opt.errors import SolverError
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Choices, Solution, SolverSettings, Status, no_answer


def unstable(qp: NullSpaceQP, h: float, k: float, scale: float, implicit: bool, h_x: float | None = None) -> str | None:
    """Return why Euler steps diverge on ``qp``, or None. Steps are h for the multipliers, h_x (default: h) for x.

    With c = scale c0 = scale c1, explicit steps are stable only if h k < c and (2 h_x k c - h h_x k^2) |A|^2 < 4.
    Semi-implicit steps are stable only if (2 h_x k c + h h_x k^2) |A|^2 < 4. |A| is the largest singular value of
    A = [J_T; J_W]. If c0 and c1 differ, c is the smaller one in h k < c, and the larger one in the conditions with |A|.
    """
    c0, c1 = scale * qp.c0, scale * qp.c1
    weak, strong, hk = min(c0, c1), max(c0, c1), h * k
    if not implicit and not hk < weak:
        return (
            f"h k = {hk:g} is not below {'scale ' if scale != 1.0 else ''}min(c0, c1) = {weak:g}: "
            "the explicit steps diverge; lower h or k, or raise the weights"
        )
    if weak <= 0.0:
        return "c0 and c1 must be above 0: nothing else damps the multipliers"
    largest = float(np.linalg.norm(qp.A, 2))
    # `largest**2` could raise OverflowError.
    hk_x = hk if h_x is None else h_x * k
    stiff = (2.0 * hk_x * strong + (hk * hk_x if implicit else -hk * hk_x)) * largest * largest
    if not stiff < 4.0:
        return f"the steps diverge: h, k, c0, c1 and |A| give {stiff:.2f} instead of less than 4; lower h or k"
    return None


class Network(SolverSettings):
    """Base of `RNN` and `RNNPrinted`."""

    h: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.h > 1.0:
            raise SolverError(f"{self.name}: h = {self.h!r} is above 1: x would leave its bounds; give at most 1")


class RNNSession:
    """The state of one network: x and the multipliers."""

    def __init__(self, settings: Any, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._rest(qp.n)

    def _rest(self, n: int) -> None:
        self._x, self._y = np.zeros(n), np.zeros(6)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem."""
        s = self._settings
        return self._advance(qp, s.steps, s.h, s.h, s.scale, s.method == "semi-implicit")

    def _advance(self, qp: NullSpaceQP, most: int, h_x: float, h_y: float, scale: float, implicit: bool) -> Solution:
        """Do at most ``most`` steps. If x or a multiplier is no longer finite, set all of them to zero."""
        if qp.n != len(self._x):
            self._rest(qp.n)
        s, x, y = self._settings, self._x, self._y
        code, steps = core.step_network(qp.row, x, y, most, h_x, h_y, s.k, scale, implicit, s.eps)
        if code == core.DOUBTFUL:
            self._rest(qp.n)
            return no_answer(qp.n, Status.NUMERICAL, steps)
        status = Status.SOLVED if code == core.OK else Status.MAX_ITER
        return Solution(x.copy(), y / scale, status, steps)


class RNNPrintedSession(RNNSession):
    """A network whose x is the measured velocity."""

    def observe(self, v: ArrayLike) -> None:
        """Use the measured joint velocity v (n,) [rad/s] as x at the next tick."""
        self._x = np.array(v, dtype=float)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Compute x = clip(v - k dL/dx) with the gradient at v, then integrate the multipliers over one tick."""
        return self._advance(qp, 1, 1.0, self._settings.h, 1.0, False)


@dataclass(frozen=True)
class RNN(Network):
    """The network. Its state continues from tick to tick.

    Args:
        steps: limit on the steps per tick.
        h: step size dt / (the network's time constant), in (0, 1].
        k: the paper's gain.
        scale: factor of c0, c1, c2 and the regularization. It does not change the optimum.
        method: "explicit" Euler, or "semi-implicit" (the multipliers use the new x).
        eps: an answer is SOLVED if no entry of the network's right-hand side exceeds eps [rad/s, m/s].

    Raises:
        SolverError: a setting is out of range, or (from ``start``) the steps would diverge.
    """

    steps: int = 10
    h: float = 1.0
    k: float = 0.5
    scale: float = 100.0
    method: Literal["explicit", "semi-implicit"] = "explicit"
    eps: float = 1e-7
    name = "rnn"
    session = RNNSession
    choices: ClassVar[Choices] = {"method": ("explicit", "semi-implicit")}

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return why the steps would diverge, or None."""
        return unstable(qp, self.h, self.k, self.scale, self.method == "semi-implicit")


@dataclass(frozen=True)
class RNNPrinted(Network):
    """Equation (2) of the paper as printed: on its right-hand side, the measured joint velocity v stands for x.

    Each tick needs ``session.observe(v)`` first.

    Args:
        k: the paper's gain.
        h: step of the multipliers, dt / (the network's time constant). The steps diverge unless h k < c0 and h k < c1.
        eps: an answer is SOLVED if no entry of the network's right-hand side exceeds eps [rad/s, m/s].

    Raises:
        SolverError: a setting is out of range, or (from ``start``) the steps would diverge.
    """

    k: float = 0.1
    h: float = 0.002
    eps: float = 1e-9
    name = "rnn-printed"
    session = RNNPrintedSession

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return why the steps would diverge, or None."""
        return unstable(qp, self.h, self.k, 1.0, False, h_x=1.0)
