"""The control tick as dependency-free C: written out by CasADi, exported, or compiled and loaded back."""

from moc_opt.embedded.compiler import CompilerError
from moc_opt.embedded.export import export, record
from moc_opt.embedded.native import NativeController
from moc_opt.embedded.source import Recording
from moc_opt.embedded.support import check_supported

__all__ = ["CompilerError", "NativeController", "Recording", "check_supported", "export", "record"]
