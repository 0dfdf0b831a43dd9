"""A solver's session for the loop, or the reason why there is none."""

from __future__ import annotations

from moc_opt.errors import ControlError, MocOptError, describe
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Session, Solver


def start_session(solver: Solver, qp: NullSpaceQP) -> Session:
    """Start a session for problems like ``qp``.

    Raises:
        ControlError: the solver does not take the problem or hands back no session, in its own words or in those of
            what it raised. A MocOptError of its own passes.
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
