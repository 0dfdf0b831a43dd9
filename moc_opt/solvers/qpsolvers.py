"""Adapter of the package qpsolvers. Its solvers are named ``qpsolvers:NAME``.

Solve times include the conversion of the problem, so they do not show the libraries' speeds.
"""

from __future__ import annotations

import math
import pkgutil
import warnings
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
import qpsolvers
from qpsolvers.exceptions import QPError

from moc_opt.errors import SolverError, UnknownNameError, describe
from moc_opt.qp.problem import ROWS, NullSpaceQP
from moc_opt.solvers.base import MOST, Choices, Session, Solution, SolverSettings, Status, no_answer
from moc_opt.solvers.library import refuse_semidefinite


class Advice(NamedTuple):
    """Settings under which a library's reported status can be trusted."""

    cost_scale: float = 1.0  #: factor of P and p
    options: Mapping[str, Any] = {}  #: keyword arguments of the library


# The libraries' tolerances are absolute. The cost's gradient is only about 1e-4, so the cost is scaled up.
ADVICE: dict[str, Advice] = {
    "clarabel": Advice(1e3),
    "daqp": Advice(1e3),
    "highs": Advice(1e3, {"time_limit": 0.1}),  # with unscaled cost, its QP solver cycles for ever
    "osqp": Advice(1e2, {"eps_abs": 1e-8, "eps_rel": 0.0}),  # with eps_abs = 1e-3, nine answers in ten are wrong
    "piqp": Advice(1e3, {"eps_abs": 1e-9, "eps_rel": 0.0}),
    # proxqp's eps_primal_inf cannot be set through qpsolvers, so proxqp calls 4 % of feasible problems infeasible.
    "proxqp": Advice(1e3, {"eps_abs": 1e-9, "eps_rel": 0.0}),
    "scs": Advice(1e3, {"eps_abs": 1e-8, "eps_rel": 0.0}),  # with eps_abs = 1e-4, half of the answers are wrong
}

ALLOWED = {
    name: frozenset(listed.split())
    for name, listed in {
        "qpsolvers:clarabel": """
            tol_gap_abs tol_gap_rel tol_feas tol_infeas_abs tol_infeas_rel tol_ktratio
            reduced_tol_gap_abs reduced_tol_gap_rel reduced_tol_feas reduced_tol_infeas_abs
            reduced_tol_infeas_rel reduced_tol_ktratio max_iter time_limit max_step_fraction
            equilibrate_enable equilibrate_max_iter presolve_enable static_regularization_enable
            dynamic_regularization_enable iterative_refinement_enable iterative_refinement_max_iter
            iterative_refinement_abstol iterative_refinement_reltol""",
        "qpsolvers:cvxopt": "abstol reltol feastol maxiters refinement",
        "qpsolvers:daqp": """
            primal_tol dual_tol zero_tol pivot_tol progress_tol cycle_tol sing_tol refactor_tol
            iter_limit time_limit fval_bound eps_prox eta_prox rho_soft""",
        "qpsolvers:ecos": "abstol reltol feastol abstol_inacc reltol_inacc feastol_inacc max_iters nitref",
        "qpsolvers:gurobi": "FeasibilityTol OptimalityTol PSDTol BarConvTol TimeLimit IterationLimit BarIterLimit",
        "qpsolvers:highs": """
            time_limit primal_feasibility_tolerance dual_feasibility_tolerance primal_residual_tolerance
            dual_residual_tolerance optimality_tolerance kkt_tolerance ipm_optimality_tolerance
            qp_iteration_limit qp_nullspace_limit qp_regularization_value simplex_iteration_limit
            ipm_iteration_limit random_seed""",
        "qpsolvers:osqp": """
            eps_abs eps_rel eps_prim_inf eps_dual_inf max_iter time_limit rho rho_is_vec sigma alpha
            delta scaling adaptive_rho adaptive_rho_interval adaptive_rho_fraction
            adaptive_rho_tolerance polishing polish_refine_iter check_termination check_dualgap
            scaled_termination""",
        "qpsolvers:piqp": """
            eps_abs eps_rel check_duality_gap eps_duality_gap_abs eps_duality_gap_rel
            infeasibility_threshold rho_init delta_init reg_lower_limit reg_finetune_lower_limit
            max_iter max_factor_retires tau preconditioner_iter preconditioner_scale_cost
            iterative_refinement_always_enabled iterative_refinement_eps_abs
            iterative_refinement_eps_rel iterative_refinement_max_iter""",
        "qpsolvers:proxqp": """
            eps_abs eps_rel rho mu_eq mu_in max_iter compute_preconditioner check_duality_gap
            eps_duality_gap_abs eps_duality_gap_rel primal_infeasibility_solving""",
        "qpsolvers:qpalm": "eps_abs eps_rel max_iter rho theta delta sigma_max proximal",
        "qpsolvers:qpoases": "time_limit max_wsr boundRelaxation epsNum epsDen numRefinementSteps terminationTolerance",
        "qpsolvers:qpswift": "ABSTOL RELTOL SIGMA MAXITER",
        "qpsolvers:scs": """
            eps_abs eps_rel eps_infeas max_iters time_limit_secs normalize scale adaptive_scale rho_x
            alpha acceleration_lookback acceleration_interval""",
    }.items()
}  # fmt: skip
"""The options that may be set, by library. None reads or writes a file, loads or compiles code, or prints."""

# With sparse libraries, qpsolvers warns at each call.
_NOISY = set(qpsolvers.sparse_solvers) - set(qpsolvers.dense_solvers)


def reasons() -> dict[str, str | None]:
    """Map each library to the reason why it cannot run here, or to None."""
    known = {module.name.strip("_") for module in pkgutil.iter_modules(qpsolvers.solvers.__path__)}
    here = set(qpsolvers.available_solvers)
    return {
        name: None if name in here else f"qpsolvers does not find it here: pip install qpsolvers[{name}]"
        for name in sorted(known | here)
    }


def checked(solver: str, options: object) -> dict[str, Any]:
    """Return a copy of a library's options. Raise an error if a name or a value is not allowed."""
    if not isinstance(options, Mapping):
        raise SolverError(f"{solver}: options = {options!r:.80} is not a table of keyword arguments")
    allowed = ALLOWED.get(solver, frozenset())
    for name, value in options.items():
        if name not in allowed:
            raise UnknownNameError(f"option of {solver}", str(name), allowed)
        if not isinstance(value, (bool, int, float)) or not math.isfinite(value) or abs(value) > MOST:
            raise SolverError(
                f"{solver}: option {name} = {value!r:.80}: give true, false or a number of magnitude {MOST:.3g} or less"
            )
    return dict(options)


class QPSolverSession:
    """A session that keeps nothing between ticks."""

    def __init__(self, settings: QPSolver, qp: NullSpaceQP) -> None:
        self._settings, self._advice = settings, settings.advice

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem."""
        if self._settings.supports(qp) is not None:
            return no_answer(qp.n, Status.UNSUPPORTED)
        try:
            return self.attempt(qp) if np.isfinite(qp.row[: -qp.n]).all() else no_answer(qp.n, Status.NUMERICAL)
        except (QPError, ValueError, ArithmeticError):  # a failed factorisation
            return no_answer(qp.n, Status.NUMERICAL)

    def attempt(self, qp: NullSpaceQP) -> Solution:
        """Like `solve`, but raise what the library raises."""
        P, p, A, b, lift = qp.assembled(self._settings.rows)
        scale, library = self._advice.cost_scale, self._settings.library
        # Pass copies: daqp refuses read-only arrays.
        problem = qpsolvers.Problem(
            P * scale, p * scale, None, None, A.copy(), b.copy(), qp.lower.copy(), qp.upper.copy()
        )
        with warnings.catch_warnings() if library in _NOISY else nullcontext():
            if library in _NOISY:
                warnings.simplefilter("ignore")
            found = qpsolvers.solve_problem(problem, library, **self._advice.options)
        count = found.extras.get("iter", found.extras.get("iterations", getattr(found.extras.get("info"), "iter", 0)))
        iterations = int(np.ravel(count)[0])  # quadprog returns two counts
        if not found.found:
            return no_answer(qp.n, self._verdict(found), iterations)
        x = np.array(found.x, dtype=float)
        if not np.isfinite(x).all():
            return no_answer(qp.n, Status.NUMERICAL, iterations)
        return Solution(x, np.dot(found.y, lift) / scale, Status.SOLVED, iterations)

    def _verdict(self, found: qpsolvers.Solution) -> Status:
        """Return the status of a solve that found no answer."""
        if self._settings.library == "quadprog":  # at other failures, quadprog raises an exception
            return Status.INFEASIBLE
        limit = self._advice.options.get("time_limit")
        if limit is not None and found.solve_time is not None and found.solve_time >= limit:
            return Status.TIME_LIMIT
        text = str(found.extras.get("status", getattr(found.extras.get("info"), "status", ""))).lower()
        if "inaccurate" in text or "almost" in text or ("max" in text and "iter" in text):
            return Status.MAX_ITER
        if "infeasible" in text and "dual" not in text:
            return Status.INFEASIBLE
        return Status.TIME_LIMIT if "time" in text else Status.NUMERICAL


@dataclass(frozen=True)
class QPSolver(SolverSettings):
    """One library behind ``qpsolvers.solve_problem``.

    Args:
        library: name of the library in qpsolvers.
        rows: 6 equality rows (tip and wrist), or 5 independent ones. With 6, daqp fails on 1 % of the problems.
        cost_scale: factor of P and p; None: the one in `ADVICE`.
        options: options of the library, with names from `ALLOWED`. They take precedence over those of `ADVICE`.
        advised: if False, `ADVICE` is ignored.

    Raises:
        SolverError: a setting is out of range, or (from ``start``) the library refuses an option.
    """

    library: str
    rows: int = 5
    cost_scale: float | None = None
    options: Mapping[str, Any] | None = field(default=None, hash=False)
    advised: bool = True
    session = QPSolverSession
    choices: ClassVar[Choices] = {"rows": ROWS}
    name = property(lambda self: f"qpsolvers:{self.library}", doc="Name in the registry.")  # type: ignore[assignment]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "options", checked(self.name, {} if self.options is None else self.options))

    @property
    def advice(self) -> Advice:
        """The library's `ADVICE`, with the values of these settings where they are given."""
        base = ADVICE.get(self.library, Advice()) if self.advised else Advice()
        scale = base.cost_scale if self.cost_scale is None else self.cost_scale
        return Advice(scale, {**base.options, **(self.options or {})})

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return why quadprog refuses the problem, or None."""
        needs = "quadprog needs a positive definite cost"
        return refuse_semidefinite(qp, needs) if self.library == "quadprog" else None

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a session. Raise a SolverError if the library refuses an option."""
        session = super().start(qp)
        if self.options:
            try:
                session.attempt(qp)  # type: ignore[attr-defined]
            except (QPError, FloatingPointError, ZeroDivisionError):
                pass  # the problem failed, not the options
            except Exception as error:  # each library raises its own types of exceptions
                refused = f"options = {self.options} are refused ({describe(error)}); see the library's manual"
                raise SolverError(f"{self.name}: {refused}") from error
        return session
