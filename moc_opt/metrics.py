"""The metrics of a run, under their old name: see `moc_opt.trace.metrics`."""

from moc_opt.trace.metrics import *  # noqa: F403
