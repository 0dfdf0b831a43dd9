"""Means and changes with bootstrap intervals: `moc_opt.comparison.statistics`, under its former name."""

from moc_opt.comparison.statistics import *  # noqa: F403
