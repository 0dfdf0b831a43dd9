"""The closed loop over a wire: the plant keeps the time in one process, the controller answers from another.

Read first: ``packets`` (what goes over the wire, byte by byte), then ``remote`` (the plant's end: a controller that is
somewhere else, with its ``watchdog``) and ``answering`` (the controller's end). ``link`` is the socket with its checks,
``key`` says who may speak, ``clock`` keeps the time and asks the system for what a real-time process needs.
Both ends drive the parts of the simulator: ``sim.closed_loop`` with the remote controller in it here,
``sim.filtered`` with the safety filter there. Knows no control law. Imported by scenario, which composes both ends
(``scenario.wired``); what users read is docs/realtime.md.
"""

from moc_opt.realtime.key import WireError

__all__ = ["WireError"]
