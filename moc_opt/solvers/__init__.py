"""Solvers of the null-space subproblem (`moc_opt.qp`), all with the same interface.

Read first: ``base``, then ``registry``. docs/extending.md shows how to add a solver.
"""

from moc_opt.solvers.base import Session, Solution, Solver, Status
from moc_opt.solvers.registry import available, create

__all__ = ["Session", "Solution", "Solver", "Status", "available", "create"]
