"""The paper's operative procedure: augmented reality and hand guiding.

Read ``augmented_reality`` first. Its parts are ``board``, ``camera`` and ``tracking``, which need OpenCV (the extra
``vision``). In ``hands_on``, a hand guides the tool to the incision and the trocar is registered.
"""
