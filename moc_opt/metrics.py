"""Metrics of a run: the short import path of `moc_opt.trace.metrics`."""

from moc_opt.trace.metrics import *  # noqa: F403
