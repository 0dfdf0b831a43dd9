"""Export a scenario's controller as a folder of C files."""

from moc_opt.export.folder import write
from moc_opt.export.scenario import export_scenario

__all__ = ["export_scenario", "write"]
