"""The paper's operative procedure: augmented reality, hand guiding, and the checks before anything moves.

- ``augmented_reality``: all of the camera's side put together; read it first
- ``settings``, ``pose``, ``board``, ``camera``, ``tracking``, ``overlay``: its parts (OpenCV, the extra ``vision``)
- ``hands_on``: the trocar is registered by guiding the tool by hand
- ``preflight``: whether a start and a path can be done, and random starts; ``scenario`` needs this one alone
"""
