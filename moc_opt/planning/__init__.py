"""Planning over the redundancy: what an arm may do while tip and wrist stay, and which of it, when, along a path.

Read first: ``self_motion`` (the curve of poses with one tip and wrist; ``arm_angle`` the swivel of the elbow) and
``freedoms`` (how many there are). For a path: ``course`` (what it asks for, and a course along it), ``pose_map`` (every
pose at every time), ``search`` (V, what a pose is worth to the end), ``program`` (a course improved and made smooth),
``plan`` (all of it before a run). In the loop: ``follow``. ``largest`` is the largest mu at given points of any arm;
``swivel_map`` and ``map_analysis`` show runs on mu over time and swivel; ``transient`` finds the ticks at which the
elbow moves to its optimum. Imports core, robots, tasks and trace.
"""
