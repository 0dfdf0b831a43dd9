"""The subproblem as a nonlinear program in CasADi, with mu itself instead of its gradient.

    max_x  c2 (mu(q + x T)/T + d^T x) - regularization/2 |x|^2,   d = g - grad mu(q)
    s.t.   tip(q + x T) = tip(q) + v_T T,   E (wrist(q + x T) - wrist(q)) = E v_W T,   lower <= x <= upper

T is the control period. g, v_T and v_W are the subproblem's `pull`, `v_tip` and `v_wrist`. The rows of E (2, 3) span
the plane perpendicular to the tool. The program equals the subproblem only for T -> 0, so answers fail ``verified()``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal, Protocol

import casadi as ca
import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import SolverError
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Choices, Solution, SolverSettings, Status, no_answer


class Kinematics(Protocol):
    """CasADi functions of q (n,): tip and wrist (3,) [m], mu [m^3]. The object must be hashable."""

    n: int
    tip: Any
    wrist: Any
    mu: Any


_STATUS = {
    "Solve_Succeeded": Status.SOLVED,
    "Maximum_Iterations_Exceeded": Status.MAX_ITER,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
}


def buffered(function: Any, arguments: Mapping[str, Array], results: Mapping[str, Array]) -> tuple[Any, Any]:
    """Bind a CasADi function to the caller's arrays. Return (buffer, call)."""
    buffer, call = function.buffer()
    for name, array in arguments.items():
        buffer.set_arg(function.index_in(name), array.data)
    for name, array in results.items():
        buffer.set_res(function.index_out(name), array.data)
    return buffer, call


@lru_cache(maxsize=16)
def program(settings: NLP) -> tuple[Any, Any]:
    """Return the NLP solver, and a function from q (n,) to tip, wrist, mu and grad mu."""
    kinematics, n, period = settings.kinematics, settings.kinematics.n, settings.period
    x, q, base, E = ca.SX.sym("x", n), ca.SX.sym("q", n), ca.SX.sym("base", 7), ca.SX.sym("E", 2, 3)
    beside, c2, regularization = ca.SX.sym("beside", n), ca.SX.sym("c2"), ca.SX.sym("regularization")

    def places(q: Any) -> Any:
        return ca.vertcat(kinematics.tip(q), kinematics.wrist(q), kinematics.mu(q))

    moved = (places(q + period * x) - base) / period
    nlp = {
        "x": x,
        "p": ca.vertcat(q, base, beside, ca.vec(E), c2, regularization),
        "f": settings.cost_scale * (0.5 * regularization * ca.dot(x, x) - c2 * (moved[6] + ca.dot(beside, x))),
        "g": ca.vertcat(moved[:3], ca.mtimes(E, moved[3:6])),
    }
    quiet = {"print_time": False, "error_on_fail": False}
    solver = ca.nlpsol("solver", settings.plugin, nlp, {**quiet, **settings._options()})
    slope = ca.gradient(kinematics.mu(q), q)
    return solver, ca.Function("places", [q], [ca.vertcat(places(q), slope)])


class NLPSession:
    """A session. A solve starts from the previous optimum, or from 0 if the previous solve failed."""

    def __init__(self, settings: NLP, qp: NullSpaceQP) -> None:
        self._settings, n = settings, qp.n
        solver, places = program(settings)
        self._q, self._base, self._p = np.zeros(n), np.zeros(7 + n), np.zeros(n + 7 + n + 6 + 2)
        self._lower, self._upper, self._target = np.zeros(n), np.zeros(n), np.zeros(5)
        self._start = {"x0": np.zeros(n), "lam_g0": np.zeros(5), "lam_x0": np.zeros(n)}
        self._end = {"x": np.zeros(n), "lam_g": np.zeros(5), "lam_x": np.zeros(n)}
        self._places = buffered(places, {places.name_in(0): self._q}, {places.name_out(0): self._base})
        sides = {"lbx": self._lower, "ubx": self._upper, "lbg": self._target, "ubg": self._target}
        self._solver = buffered(solver, {"p": self._p, **sides, **self._start}, self._end)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem."""
        if self._settings.supports(qp) is not None:
            return no_answer(qp.n, Status.UNSUPPORTED)
        lift = qp.assembled().lift
        self._load(qp, lift)
        x0, x, multipliers = self._start["x0"], self._end["x"], self._end["lam_g"]
        np.clip(x0, self._lower, self._upper, out=x0)
        buffer, run = self._solver
        run()
        stats = buffer.stats()
        status, iterations = _STATUS.get(str(stats["return_status"]), Status.NUMERICAL), int(stats["iter_count"])
        if not (np.isfinite(x).all() and np.isfinite(multipliers).all()):
            status = Status.NUMERICAL
        if status is Status.SOLVED:
            for start, end in zip(self._start.values(), self._end.values(), strict=True):
                start[:] = end
        else:
            for start in self._start.values():
                start[:] = 0.0
        if status not in (Status.SOLVED, Status.MAX_ITER):
            return no_answer(qp.n, status, iterations)
        return Solution(x.copy(), np.dot(multipliers, lift) / self._settings.cost_scale, status, iterations)

    def _load(self, qp: NullSpaceQP, lift: Array) -> None:
        n, part, p = qp.n, qp.fields, self._p
        self._q[:] = part.q
        self._places[1]()
        p[:n] = part.q
        p[n : n + 7] = self._base[:7]
        np.subtract(part.pull, self._base[7:], out=p[n + 7 : 2 * n + 7])
        p[2 * n + 7 : 2 * n + 13] = lift[3:, 3:].ravel(order="F")
        p[2 * n + 13 :] = part.weights[2:]
        self._lower[:], self._upper[:] = part.lower, part.upper
        np.dot(lift, part.b, out=self._target)


@dataclass(frozen=True)
class NLP(SolverSettings, ABC):
    """Base of ``SQP`` and ``Ipopt``.

    Args:
        kinematics: tip, wrist and mu as CasADi functions, from ``robot.kinematics()``.
        period: T [s], the control period.
        cost_scale: factor of the cost. The duals are divided by it.
        eps: tolerance of the KKT conditions.
        max_iter: limit on the iterations of a solve.
        hessian: "limited-memory" (BFGS) or "exact".
    """

    kinematics: Kinematics = None  # type: ignore[assignment]
    period: float = 0.002
    cost_scale: float = 1e4
    eps: float = 1e-7
    max_iter: int = 50
    hessian: Literal["limited-memory", "exact"] = "exact"
    plugin = ""
    session = NLPSession
    choices: ClassVar[Choices] = {"hessian": ("limited-memory", "exact")}

    def __post_init__(self) -> None:
        if not all(hasattr(self.kinematics, key) for key in ("n", "tip", "wrist", "mu")):
            raise SolverError(
                f"{self.name}: kinematics = {self.kinematics!r} has no n, tip, wrist and mu; "
                "pass kinematics=robot.kinematics()"
            )
        super().__post_init__()

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return why the program does not apply, or None."""
        if qp.q is None:
            return "the subproblem has no q, but an NLP needs the joint positions of the linearization"
        if qp.n != self.kinematics.n:
            return f"the kinematics have {self.kinematics.n} joints, the subproblem has {qp.n}"
        if len(qp.assembled().b) != 5:
            return "tip and wrist are not rigidly connected: the five rows of this program do not apply"
        return None

    @abstractmethod
    def _options(self) -> dict[str, Any]:
        """Return the options of the CasADi plug-in."""


@dataclass(frozen=True)
class SQP(NLP):
    """CasADi's sqpmethod with its active-set QP solver qrqp."""

    cost_scale: float = 1e5
    hessian: Literal["limited-memory", "exact"] = "limited-memory"
    name = "nlp-sqp"
    plugin = "sqpmethod"

    def _options(self) -> dict[str, Any]:
        quiet = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
        return {
            "qpsol": "qrqp", "qpsol_options": quiet, "hessian_approximation": self.hessian, "max_iter": self.max_iter,
            "tol_pr": self.eps, "tol_du": self.eps, "min_step_size": 1e-14, "print_header": False,
            "print_iteration": False, "print_status": False,
        }  # fmt: skip


@dataclass(frozen=True)
class Ipopt(NLP):
    """The interior-point method IPOPT (Waechter & Biegler 2006)."""

    name = "nlp-ipopt"
    plugin = "ipopt"

    def _options(self) -> dict[str, Any]:
        options = {
            "print_level": 0, "sb": "yes", "hessian_approximation": self.hessian, "max_iter": self.max_iter,
            "tol": self.eps, "acceptable_iter": 0, "bound_relax_factor": 0.0, "nlp_scaling_method": "none",
            # Otherwise IPOPT reads ipopt.opt in the current folder, which may load libraries.
            "option_file_name": "",
        }  # fmt: skip
        return {f"ipopt.{key}": value for key, value in options.items()}
