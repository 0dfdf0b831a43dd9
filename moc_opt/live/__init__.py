"""A run in real time whose solver, gains and trocar can be changed while it goes: ``moc-opt live``.

- ``live.run.LiveRun``: the loop, and the changes that it takes while it runs; no page
- ``live.page.serve``: the page on top of it, on loopback; ``live.access`` decides who may see it

Imported by the command line alone.
"""

from moc_opt.live.orders import LiveError, Moment
from moc_opt.live.run import LiveRun

__all__ = ["LiveError", "LiveRun", "Moment"]
