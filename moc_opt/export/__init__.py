"""A scenario's controller as a folder of C: the core's own files, constants, recorded ticks and a Makefile.

``scenario`` checks that C can do what a scenario asks for, and records ticks; ``folder`` writes the files.
"""

from moc_opt.export.folder import write
from moc_opt.export.scenario import export_scenario

__all__ = ["export_scenario", "write"]
