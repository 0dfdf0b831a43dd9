"""The closed loop over UDP: the plant keeps the time in one process, the controller answers in another.

Read ``wire`` first (packets and the socket), then ``ends`` (the plant's end with its watchdog, and the controller's
end). ``scenario.wired`` makes both ends from a scenario. docs/realtime.md is for users.
"""
