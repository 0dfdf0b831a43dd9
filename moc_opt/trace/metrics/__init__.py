"""From a trace to numbers: one function per metric under `@metric`, in the file of its subject.

A new metric is one function; its name, with the unit in it, is the key in every summary. It reads the columns it needs;
a trace without them is summarized without it.
"""

# isort: off
from moc_opt.trace.metrics.registry import *  # noqa: F403

# The subjects in the order of a summary.
from moc_opt.trace.metrics.ending import *  # noqa: F403
from moc_opt.trace.metrics.manipulability import *  # noqa: F403
from moc_opt.trace.metrics.tracking import *  # noqa: F403
from moc_opt.trace.metrics.torque import *  # noqa: F403
from moc_opt.trace.metrics.solver import *  # noqa: F403
