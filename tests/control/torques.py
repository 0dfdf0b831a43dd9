"""The compiled parts of a tick, called with the parts of a law by name."""

import numpy as np

from moc_opt.control import tick
from moc_opt.control.law import packed


def of(kernel, form):
    """A kernel compiled, or as plain Python."""
    return kernel if form == "compiled" else kernel.py_func


def tracking(state, tip_ref, trocar, form="compiled", **law):
    """tau_tip + tau_rcm (n,) [Nm]; ``law`` as for ``law.packed``."""
    n = state.n
    return of(tick.tracking_torque, form)(state.record, packed(n, **law), tip_ref, trocar, np.zeros(n))


def third(state, Z, x, K_N2, D_N2, share=1.0, form="compiled"):
    """tau_mu (n,) [Nm]."""
    return of(tick.third_level, form)(state.record, packed(state.n, K_N2=K_N2, D_N2=D_N2), Z, x, share)


def subproblem(state, tip_ref, trocar, form="compiled", **law):
    """The flat record of the tick's subproblem."""
    row = np.empty(10 * state.n + 10)
    of(tick.fill_subproblem, form)(state.record, packed(state.n, **law), tip_ref, trocar, row)
    return row
