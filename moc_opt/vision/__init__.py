"""The paper's operative procedure: augmented reality and hand guiding.

Read ``augmented_reality`` first; its parts are ``board``, ``camera`` and ``tracking`` (they need OpenCV, the extra
``vision``). ``hands_on`` registers the trocar by guiding the tool by hand.
"""
