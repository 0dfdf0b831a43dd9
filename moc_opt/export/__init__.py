"""Export a scenario's controller as a folder of C files.

``scenario`` records ticks, and ``folder`` writes the files.
"""

from moc_opt.export.folder import write
from moc_opt.export.scenario import export_scenario

__all__ = ["export_scenario", "write"]
