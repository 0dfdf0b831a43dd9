"""The closed loop over UDP: the plant keeps the time in one process, the controller answers in another.

Read first: ``wire`` (the packets, and the socket with its checks), then ``ends`` (the plant's with its watchdog, and
the controller's). ``scenario.wired`` composes both ends; for users: docs/realtime.md.
"""
