"""The control tick as dependency-free C: written out by CasADi, exported, or compiled and loaded back.

Read first: ``export`` (which files a folder gets) and ``source`` (how the equations become C); ``symbolic`` and
``dynamics`` hold the equations. ``c/`` holds the files that are copied as they are, and the templates (``.in``);
``native`` loads the bare tick into Python, ``guarded`` the whole of it. ``support`` refuses settings that the C
does not have.
Imported by scenario. For users: docs/embedded.md.
"""

from moc_opt.embedded.compiler import CompilerError
from moc_opt.embedded.export import export, record
from moc_opt.embedded.native import NativeController
from moc_opt.embedded.source import Recording
from moc_opt.embedded.support import TickSpec, check_supported

__all__ = ["CompilerError", "NativeController", "Recording", "TickSpec", "check_supported", "export", "record"]
