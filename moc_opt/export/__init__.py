"""Export a scenario's controller as a folder of C: the core's C files, constants, recorded ticks and a Makefile.

``scenario`` refuses settings that the C code does not support, and records ticks. ``folder`` writes the files.
"""

from moc_opt.export.folder import write
from moc_opt.export.scenario import export_scenario

__all__ = ["export_scenario", "write"]
