"""The paper's operative procedure: augmented reality and hand guiding.

``augmented_reality`` puts the camera's side together (read it first); ``board``, ``camera`` and ``tracking`` are its
parts (OpenCV, the extra ``vision``). With ``hands_on`` the trocar is registered by guiding the tool by hand.
"""
