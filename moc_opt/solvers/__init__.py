"""Solvers of the null-space subproblem (`moc_opt.qp`), all with the same interface.

Read first: ``base`` (``Solver``, ``Session``, ``Solution``, ``Status``), then ``registry`` (names, lazy loading,
plug-ins). Each QP library has one file, which builds on ``library`` and is imported when its solver is created.
``qpsolvers`` adapts any library that the package qpsolvers finds. ``exact`` and ``rnn`` are this package's own solvers.
The cost of ``nlp`` has the manipulability instead of its gradient. ``isolated`` runs a solver in a separate
process. ``faulty`` makes a solver fail, for tests. docs/extending.md shows how to add a solver.
"""

from moc_opt.solvers.base import Session, Solution, Solver, Status
from moc_opt.solvers.registry import available, create

__all__ = ["Session", "Solution", "Solver", "Status", "available", "create"]
