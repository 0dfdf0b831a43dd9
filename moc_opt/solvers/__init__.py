"""Solvers of the null-space subproblem behind one interface.

Read first: ``base`` (``Solver``, ``Session``, ``Solution``, ``Status``), then ``registry`` (names, lazy loading, other
packages' plug-ins). Each library has one file on top of ``library``, and is imported when its solver is made;
``qpsolvers`` takes any library that it finds. ``exact`` and ``rnn`` are this package's own, ``nlp`` has mu itself in
the cost. ``isolated`` runs any solver in a process of its own, ``faulty`` makes one fail for tests. docs/extending.md
shows how to add a solver. A solver imports ``qp``, ``core``, ``inputs`` and ``errors``, never a robot.
"""

from moc_opt.solvers.base import Session, Solution, Solver, Status
from moc_opt.solvers.registry import available, create

__all__ = ["Session", "Solution", "Solver", "Status", "available", "create"]
