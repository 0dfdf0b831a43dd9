"""A run in real time whose solver, gains and trocar can be changed while the arm moves: ``moc-opt live``."""

from moc_opt.live.run import LiveError, LiveRun

__all__ = ["LiveError", "LiveRun"]
