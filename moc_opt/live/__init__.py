"""A run in real time whose solver, gains and trocar can be changed while it goes: ``moc-opt live``.

- ``run.LiveRun``: the loop, and the changes that it takes while it runs; no page
- ``page.serve``: the page on top of it, on loopback

Imported by the command line alone.
"""

from moc_opt.live.run import LiveError, LiveRun

__all__ = ["LiveError", "LiveRun"]
