"""A run in real time that one can put a hand to: ``python -m moc_opt live``.

- ``live.run.LiveRun``: the loop in pieces, and what can be changed in it; no page
- ``live.page.serve``: the page on top of it, on loopback
"""

from moc_opt.live.orders import LiveError, Moment
from moc_opt.live.run import LiveRun

__all__ = ["LiveError", "LiveRun", "Moment"]
