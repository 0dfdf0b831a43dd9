"""Solvers of the null-space subproblem behind one interface.

Read first: ``base`` (``Solver``, ``Session``, ``Solution``, ``Status``), then ``registry`` (names, lazy loading, those
of third parties). One file a library on top of ``library``, which all of them share; ``qpsolvers`` takes any library
that it finds, and a library is imported when its solver is made. ``exact`` and ``rnn`` are ours, ``nlp`` has mu itself
in the cost. ``isolated`` runs any solver in a process of its own, ``faulty`` makes one fail for tests. To add one:
docs/extending.md. A solver imports ``qp``, ``core``, ``inputs`` and ``errors``, never a robot.
"""

from moc_opt.solvers.base import Session, Solution, Solver, Status
from moc_opt.solvers.registry import available, create

__all__ = ["Session", "Solution", "Solver", "Status", "available", "create"]
