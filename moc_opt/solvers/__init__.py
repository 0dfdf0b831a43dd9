"""Solvers of the null-space subproblem behind one interface.

Read first: ``base`` (``Solver``, ``Session``, ``Solution``, ``Status``), then ``registry`` (names and lazy
loading) and ``plugins`` (those of third parties). Each kind has a room: ``exact``, ``neural``, ``nlp``,
``backends``. ``faulty`` makes any solver fail for tests, ``checks`` and ``options`` check settings. To add
one: docs/extending.md. A QP solver imports ``qp``, ``numerics``, ``inputs`` and ``errors``, never a robot; control
imports only ``base``.
"""

from moc_opt.solvers.base import Session, Solution, Solver, Status
from moc_opt.solvers.registry import available, create

__all__ = ["Session", "Solution", "Solver", "Status", "available", "create"]
