"""The paper's operative procedure: augmented reality, hand guiding, and the checks before anything moves.

``augmented_reality`` puts the camera's side together (read it first); ``board``, ``camera`` and ``tracking`` are its
parts (OpenCV, the extra ``vision``). With ``hands_on`` the trocar is registered by guiding the tool by hand.
``preflight`` says whether a start and a path can be done, and draws random starts; ``scenario`` needs this one alone.
"""
