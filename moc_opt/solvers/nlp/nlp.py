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
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal, Protocol

import casadi as ca

from moc_opt.errors import SolverError
from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.nlp.session import NLPSession


class Kinematics(Protocol):
    """CasADi functions of q (n,): tip and wrist (3,) [m], mu. Hashable, so that programs can be kept."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def tip(self) -> Any:
        """Function q -> (3,) [m]."""

    @property
    def wrist(self) -> Any:
        """Function q -> (3,) [m]."""

    @property
    def mu(self) -> Any:
        """Function q -> mu [m^3]."""


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
    solver = ca.nlpsol("solver", settings.plugin, nlp, settings.options())
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
        checks.like_defaults(self, hessian=("limited-memory", "exact"))

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Say what is missing: it needs to know where the problem was linearized, and a rigid tool."""
        if qp.q is None:
            return "the subproblem has no q; an NLP needs the position where it was linearized"
        if qp.n != self.kinematics.n:
            return f"the kinematics have {self.kinematics.n} joints, the subproblem has {qp.n}"
        if len(assembled(qp).b) != 5:
            return "tip and wrist are not rigidly tied: the five rows of this program do not apply"
        return None

    def start(self, qp: NullSpaceQP) -> NLPSession:
        """Return a session with buffers of its own; the compiled program is shared and holds no state."""
        reason = self.supports(qp)
        if reason is not None:
            raise SolverError(f"{self.name}: {reason}")
        return NLPSession(self, *program(self))

    @abstractmethod
    def options(self) -> dict[str, Any]:
        """Return the options of the CasADi plug-in."""


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

    def options(self) -> dict[str, Any]:
        """Return options: silent, with both KKT tolerances at eps."""
        quiet = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
        return {
            "qpsol": "qrqp",
            "qpsol_options": quiet,
            "hessian_approximation": self.hessian,
            "max_iter": self.max_iter,
            "tol_pr": self.eps,
            "tol_du": self.eps,
            "min_step_size": 1e-14,
            "print_header": False,
            "print_iteration": False,
            "print_status": False,
            "print_time": False,
            "error_on_fail": False,
        }


@dataclass(frozen=True)
class Ipopt(NLP):
    """The interior-point method IPOPT (Waechter & Biegler 2006).

    It convexifies the exact Hessian by itself; with BFGS and regularization = 0 it runs out of iterations.
    """

    name: ClassVar[str] = "nlp-ipopt"
    plugin: ClassVar[str] = "ipopt"

    def options(self) -> dict[str, Any]:
        """Return options: silent, inside the box to the last digit, without IPOPT's scaling of a cost this small."""
        return {
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            # Else IPOPT reads ipopt.opt in the current folder, which may name files to write and libraries to load.
            "ipopt.option_file_name": "",
            "print_time": False,
            "error_on_fail": False,
            "ipopt.hessian_approximation": self.hessian,
            "ipopt.max_iter": self.max_iter,
            "ipopt.tol": self.eps,
            "ipopt.acceptable_iter": 0,
            "ipopt.bound_relax_factor": 0.0,
            "ipopt.nlp_scaling_method": "none",
        }


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

    def options(self) -> dict[str, Any]:
        """Return options: silent, and without a search for stages."""
        return {
            "print_time": False,
            "error_on_fail": False,
            "structure_detection": "none",
            "fatrop.print_level": 0,
            "fatrop.max_iter": self.max_iter,
            "fatrop.tol": self.eps,
        }
