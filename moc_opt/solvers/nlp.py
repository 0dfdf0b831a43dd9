"""One control period as a nonlinear program, by CasADi: manipulability itself instead of its gradient.

    max_x  c2 (mu(q + x T)/T + d^T x) - regularization/2 |x|^2,   d = g - grad mu(q)
    s.t.   tip(q + x T) = tip(q) + v_T T,   E (wrist(q + x T) - wrist(q)) = E v_W T,   lower <= x <= upper

g is the gradient that the subproblem has: it may stand for more than mu, or for a course to follow. Where it is that of
mu, d is zero. E (2, 3) spans the plane across the tool: the wrist's third row repeats the tip's, and with six rows
nothing converges.

This is the null-space subproblem only in the limit T -> 0. At T = 2 ms and joint speeds near 1 rad/s the
curvature of the kinematics puts an optimal answer 8e-4 m/s (median of random problems, at most 6e-3) off
A x = b, at a self-motion loss of 7e-4 (at most 0.1, near singularities); all of it shrinks in proportion
to T. ``residuals().verified()`` with its default of 1e-6 is therefore False for a correct answer here:
check with looser tolerances.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal, Protocol

import casadi as ca
import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import SolverError
from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import ShownBySettings, Solution, Status, check_settings, no_answer


class Kinematics(Protocol):
    """CasADi functions of q (n,): tip and wrist (3,) [m], mu [m^3]. Hashable, so that programs can be kept."""

    n: int
    tip: Any
    wrist: Any
    mu: Any


@lru_cache(maxsize=16)
def program(settings: NLP) -> tuple[Any, Any]:
    """Return the NLP solver, and the function q -> (tip, wrist, mu, grad mu) that gives its parameters.

    The parameters of the solver are q (n,), tip, wrist and mu at q, d (n,), the columns of E, c2 and regularization.
    """
    kinematics, n, period = settings.kinematics, settings.kinematics.n, settings.period
    x, q, base, E = ca.SX.sym("x", n), ca.SX.sym("q", n), ca.SX.sym("base", 7), ca.SX.sym("E", 2, 3)
    beside = ca.SX.sym("beside", n)
    c2, regularization = ca.SX.sym("c2"), ca.SX.sym("regularization")

    def places(q: Any) -> Any:
        return ca.vertcat(kinematics.tip(q), kinematics.wrist(q), kinematics.mu(q))

    moved = (places(q + period * x) - base) / period
    nlp = {
        "x": x,
        "p": ca.vertcat(q, base, beside, ca.vec(E), c2, regularization),
        "f": settings.cost_scale * (0.5 * regularization * ca.dot(x, x) - c2 * (moved[6] + ca.dot(beside, x))),
        "g": ca.vertcat(moved[:3], ca.mtimes(E, moved[3:6])),
    }
    solver = ca.nlpsol("solver", settings.plugin, nlp, settings._options())
    slope = ca.gradient(kinematics.mu(q), q)
    return solver, ca.Function("places", [q], [ca.vertcat(places(q), slope)])


@dataclass(frozen=True)
class NLP(ABC):
    """Settings that all of them share; use ``SQP``, ``Ipopt`` or ``Fatrop``.

    Args:
        kinematics: tip, wrist and mu as CasADi functions; ``robot.kinematics()``.
        period: T [s], the control period.
        cost_scale: multiplies the cost; the duals are scaled back.
        eps: tolerance of the scaled problem's KKT conditions.
        max_iter: iterations a tick.
        hessian: "limited-memory" (BFGS) or "exact".
        warm: start from the last tick's answer where that was solved.

    Raises:
        SolverError: a setting is out of range or the kinematics are missing.
    """

    kinematics: Kinematics = None  # type: ignore[assignment]
    period: float = 0.002
    cost_scale: float = 1e4
    eps: float = 1e-7
    max_iter: int = 50
    hessian: Literal["limited-memory", "exact"] = "exact"
    warm: bool = True
    name: ClassVar[str] = ""
    plugin: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if not all(hasattr(self.kinematics, key) for key in ("n", "tip", "wrist", "mu")):
            raise SolverError(
                f"{self.name}: kinematics = {self.kinematics!r} has no n, tip, wrist and mu; "
                "pass kinematics=robot.kinematics()"
            )
        check_settings(self, hessian=("limited-memory", "exact"))

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Say what is missing: the place where the problem was linearized, or a rigid tool."""
        if qp.q is None:
            return "the subproblem has no q; an NLP needs the position where it was linearized"
        if qp.n != self.kinematics.n:
            return f"the kinematics have {self.kinematics.n} joints, the subproblem has {qp.n}"
        if len(assembled(qp).b) != 5:
            return "tip and wrist are not rigidly tied: the five rows of this program do not apply"
        return None

    def start(self, qp: NullSpaceQP) -> NLPSession:
        """Return a session with buffers of its own; the compiled program is shared and holds no state."""
        if reason := self.supports(qp):
            raise SolverError(f"{self.name}: {reason}")
        return NLPSession(self, *program(self))

    @abstractmethod
    def _options(self) -> dict[str, Any]:
        """Return the options of the CasADi plug-in: silent, and with our tolerance and limit of iterations."""


@dataclass(frozen=True)
class SQP(NLP):
    """CasADi's sqpmethod on its active-set QP solver qrqp; iterations are major ones.

    BFGS starts from the identity, which at cost_scale = 1e5 is the true Hessian of the default regularization of
    1e-5: half the iterations of 1e3. The exact Hessian is indefinite where regularization = 0: then three problems in
    ten stay without an answer.
    """

    cost_scale: float = 1e5
    hessian: Literal["limited-memory", "exact"] = "limited-memory"
    name: ClassVar[str] = "nlp-sqp"
    plugin: ClassVar[str] = "sqpmethod"

    def _options(self) -> dict[str, Any]:
        quiet = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
        return {
            "qpsol": "qrqp", "qpsol_options": quiet, "hessian_approximation": self.hessian, "max_iter": self.max_iter,
            "tol_pr": self.eps, "tol_du": self.eps, "min_step_size": 1e-14, "print_header": False,
            "print_iteration": False, "print_status": False, "print_time": False, "error_on_fail": False,
        }  # fmt: skip


@dataclass(frozen=True)
class Ipopt(NLP):
    """The interior-point method IPOPT (Waechter & Biegler 2006).

    It convexifies the exact Hessian by itself; with BFGS and regularization = 0 it runs out of iterations.
    """

    name: ClassVar[str] = "nlp-ipopt"
    plugin: ClassVar[str] = "ipopt"

    def _options(self) -> dict[str, Any]:
        return {
            "ipopt.print_level": 0, "ipopt.sb": "yes",
            # Else IPOPT reads ipopt.opt in the current folder, which may name files to write and libraries to load.
            "ipopt.option_file_name": "",
            "print_time": False, "error_on_fail": False, "ipopt.hessian_approximation": self.hessian,
            "ipopt.max_iter": self.max_iter, "ipopt.tol": self.eps, "ipopt.acceptable_iter": 0,
            "ipopt.bound_relax_factor": 0.0, "ipopt.nlp_scaling_method": "none",
        }  # fmt: skip


@dataclass(frozen=True)
class Fatrop(NLP):
    """The interior-point method FATROP (Vanroye et al. 2023), made for optimal control.

    One control period is a single stage of it, so that nothing of its structure is made use of. It can
    say that it failed, not why.
    """

    name: ClassVar[str] = "nlp-fatrop"
    plugin: ClassVar[str] = "fatrop"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hessian != "exact":
            raise SolverError(f"{self.name}: hessian = {self.hessian!r} is not to be had; 'exact' is")

    def _options(self) -> dict[str, Any]:
        return {
            "print_time": False, "error_on_fail": False, "structure_detection": "none", "fatrop.print_level": 0,
            "fatrop.max_iter": self.max_iter, "fatrop.tol": self.eps,
        }  # fmt: skip


# --- the sessions ---

# The rest (sqpmethod's "Search_Direction_Becomes_Too_Small", which is also its answer to an infeasible
# problem) proves nothing.
_STATUS = {
    "Solve_Succeeded": Status.SOLVED,
    "Maximum_Iterations_Exceeded": Status.MAX_ITER,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "0": Status.SOLVED,  # fatrop's; its 1 says no more than "not solved"
}


class BufferedCall:
    """A CasADi function that reads and writes fixed arrays: a plain call costs ten times as much.

    ``run`` calls it, and raises a RuntimeError where the function does.
    """

    def __init__(self, function: Any, arguments: dict[str, Array], results: dict[str, Array]) -> None:
        self._keep = arguments, results  # the buffer only holds their addresses
        self.run: Callable[[], None]
        self._buffer, self.run = function.buffer()
        self.stats: Callable[[], Any] = self._buffer.stats
        for name, array in arguments.items():
            self._buffer.set_arg(function.index_in(name), array.data)
        for name, array in results.items():
            self._buffer.set_res(function.index_out(name), array.data)


class NLPSession(ShownBySettings):
    """Buffers of one solver; the last answer in them is the warm start."""

    def __init__(self, settings: Any, solver: Any, places: Any) -> None:
        n = settings.kinematics.n
        self._settings, self._n = settings, n
        self._p = np.zeros(n + 7 + n + 6 + 2)
        self._x0, self._lower, self._upper, self._target = (np.zeros(k) for k in (n, n, n, 5))
        self._multipliers0, self._bound_multipliers0 = np.zeros(5), np.zeros(n)
        self._x, self._multipliers, self._bound_multipliers = np.zeros(n), np.zeros(5), np.zeros(n)
        self._q, self._base = np.zeros(n), np.zeros(7 + n)
        self._places = BufferedCall(places, {places.name_in(0): self._q}, {places.name_out(0): self._base})
        self._solver = BufferedCall(
            solver,
            {
                "x0": self._x0, "p": self._p, "lbx": self._lower, "ubx": self._upper, "lbg": self._target,
                "ubg": self._target, "lam_g0": self._multipliers0, "lam_x0": self._bound_multipliers0,
            },
            {"x": self._x, "lam_g": self._multipliers, "lam_x": self._bound_multipliers},
        )  # fmt: skip

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        if self._settings.supports(qp) is not None:
            return no_answer(qp.n, Status.UNSUPPORTED)
        n, part, lift = self._n, qp.fields, assembled(qp).lift
        self._q[:] = part.q
        self._places.run()
        self._p[:n] = part.q
        self._p[n : n + 7] = self._base[:7]
        np.subtract(part.pull, self._base[7:], out=self._p[n + 7 : 2 * n + 7])
        self._p[2 * n + 7 : 2 * n + 13] = lift[3:, 3:].ravel(order="F")
        self._p[2 * n + 13 :] = part.weights[2:]
        self._lower[:], self._upper[:] = part.lower, part.upper
        np.dot(lift, part.b, out=self._target)
        if not self._settings.warm:
            self._forget()
        np.clip(self._x0, part.lower, part.upper, out=self._x0)
        try:
            self._solver.run()
        except RuntimeError:  # fatrop raises where a closed box leaves more equations than joints
            self._forget()
            return no_answer(n, Status.NUMERICAL)
        stats = self._solver.stats()
        status = _STATUS.get(str(stats["return_status"]), Status.NUMERICAL)
        iterations = int(stats["iter_count"])
        if not (np.isfinite(self._x).all() and np.isfinite(self._multipliers).all()):
            self._forget()
            return no_answer(n, Status.NUMERICAL, iterations)
        if status is Status.SOLVED:
            self._x0[:], self._multipliers0[:] = self._x, self._multipliers
            self._bound_multipliers0[:] = self._bound_multipliers
        else:
            self._forget()
        if status not in (Status.SOLVED, Status.MAX_ITER):
            return no_answer(n, status, iterations)
        y = np.dot(self._multipliers, lift) / self._settings.cost_scale
        return Solution(self._x.copy(), y, status, iterations)

    def _forget(self) -> None:
        for start in (self._x0, self._multipliers0, self._bound_multipliers0):
            start[:] = 0.0
