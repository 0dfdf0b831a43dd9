"""Checks of a controller: the start of the solver's session, and the references of a tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import ControlError, MocOptError, describe
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Session, Solver


def start_session(solver: Solver, qp: NullSpaceQP) -> Session:
    """Start a session for problems like ``qp``.

    Raises:
        ControlError: the solver does not support the problem, raises an exception, or returns no session; the message
            is the solver's. A MocOptError of the solver passes.
    """
    name = "?"
    try:
        name = repr(solver.name)
        reason = solver.supports(qp.copy())
        if reason is None:
            session = solver.start(qp.copy())
            if callable(getattr(session, "solve", None)):
                return session
            reason = f"start returned a {type(session).__name__} without solve: return a Session"
        elif not isinstance(reason, str):
            reason = f"supports returned a {type(reason).__name__}: return None or the reason why not"
    except (KeyboardInterrupt, MocOptError):
        raise
    except BaseException as error:  # foreign code may raise anything
        raise ControlError(f"solver {name} cannot run in this controller: {describe(error)}") from error
    raise ControlError(f"solver {name} cannot run in this controller: {reason}")


def check_references(started: bool, tip_ref: NDArray[np.float64], trocar: NDArray[np.float64]) -> None:
    """Check that a tick may run; a ControlError where not started, or tip_ref is not (3, 3), or trocar not (2, 3)."""
    if not started:
        raise ControlError("tick before start: call start once before the first tick")
    if tip_ref.shape != (3, 3) or trocar.shape != (2, 3):
        raise ControlError(
            f"tip_ref has shape {tip_ref.shape}, trocar {trocar.shape}: give (3, 3) and (2, 3), a row a derivative"
        )
