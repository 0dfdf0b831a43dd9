"""A run in real time whose solver, gains and trocar can be changed while the arm moves: ``moc-opt live``.

- ``run.LiveRun``: the loop without a page
- ``page.serve``: a page on loopback for a `LiveRun`
"""

from moc_opt.live.run import LiveError, LiveRun

__all__ = ["LiveError", "LiveRun"]
