"""The closed loop over UDP: the plant keeps the time in one process, the controller answers in another.

Read first: ``packets`` (the bytes of each packet), then ``remote`` (the plant's end: a controller in another
process, with its ``watchdog``) and ``answering`` (the controller's end). ``link`` is the socket with its checks,
``key`` authenticates packets, ``clock`` keeps the time and requests real-time scheduling.
Both ends drive the parts of the simulator: ``sim.closed_loop`` with the remote controller in it here,
``sim.filtered`` with the safety filter there. Imports no control law. Imported by scenario, which composes both ends
(``scenario.wired``). For users: docs/realtime.md.
"""

from moc_opt.realtime.key import WireError

__all__ = ["WireError"]
