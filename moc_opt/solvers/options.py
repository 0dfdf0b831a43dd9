"""Which options of a library may be set: tolerances, iterations and modes; none that writes, loads or compiles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from moc_opt.errors import SolverError, UnknownNameError

MOST = 2**31 - 1
"""The largest size of a value; the libraries count in 32 bits."""

# A list of allowed options, not of forbidden ones: libraries add options with every version.
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
"""Solver -> the options that may be set. Any other solver takes none."""


def checked(solver: str, options: object) -> dict[str, Any]:
    """Return a copy of a library's options.

    Raises:
        UnknownNameError: an option is not allowed.
        SolverError: this is no table, or a value is no flag and no number.
    """
    if not isinstance(options, Mapping):
        raise SolverError(f"{solver}: options = {options!r:.80} is not a table of keyword arguments")
    allowed = ALLOWED.get(solver, frozenset())
    for name, value in options.items():
        if name not in allowed:  # what writes or reads files, loads, compiles or prints is left out
            raise UnknownNameError(f"option of {solver}", str(name), allowed)
        if not isinstance(value, (bool, int, float)) or not math.isfinite(value) or abs(value) > MOST:
            raise SolverError(
                f"{solver}: option {name} = {value!r:.80}: give true, false or a number of at most {MOST:.3g} in size"
            )
    return dict(options)
