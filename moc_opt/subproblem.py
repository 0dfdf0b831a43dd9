"""The subproblem and its residuals: the short import path of `moc_opt.qp.problem`."""

from moc_opt.qp.problem import *  # noqa: F403
from moc_opt.qp.problem import compute_residuals as judge  # noqa: F401
