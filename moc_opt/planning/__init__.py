"""Planning over the redundancy: what an arm may do while tip and wrist stay, and which of it, when, along a path.

``self_motion`` has the curve of poses with one tip and wrist, and how many freedoms there are; ``elbow`` the angle of
the elbow on it. For a path: ``course`` (targets, and a course along them), ``pose_map`` (every pose at every time),
``search`` (V, what a pose is worth to the end), ``program`` (a course improved and made smooth), ``plan`` (all of it
before a run). In the loop: ``follow``. ``swivel_map`` shows runs on mu over time and swivel. Imports core, robots,
tasks and trace.
"""
