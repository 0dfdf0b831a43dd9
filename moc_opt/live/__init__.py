"""A run in real time whose solver, gains and trocar can be changed while the arm moves: ``moc-opt live``.

- ``run.LiveRun``: the loop without a page, and all changes that are possible during a run
- ``page.serve``: a page on loopback for a `LiveRun`

Only the command line imports this package.
"""

from moc_opt.live.run import LiveError, LiveRun

__all__ = ["LiveError", "LiveRun"]
