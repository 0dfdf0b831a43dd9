"""The subproblem and its judge, under their old name: see `moc_opt.qp.problem`."""

from moc_opt.qp.problem import *  # noqa: F403
