"""The closed loop over UDP: the plant keeps the time in one process, the controller answers in another.

Read first: ``packets`` (the bytes of each packet, for Python and as a C header), then ``remote`` (the plant's end: a
controller in another process, and the watchdog in its place) and ``answering`` (the controller's end). ``link`` is the
socket with addresses, key and checks, ``clock`` keeps the time. ``scenario.wired`` composes both ends; for users:
docs/realtime.md.
"""

from moc_opt.realtime.link import WireError

__all__ = ["WireError"]
