"""The self-motion: the poses of an arm with the same tip and wrist, and manipulability along them.

Read first: ``self_motion`` (the curve of one pose, scanned; ``continuation`` holds its kernels), then
``manipulability_map`` (mu over time and elbow swivel; ``arm_angle`` is the swivel) and ``map_analysis`` (where
the trajectories of runs lie on it). ``ascent`` climbs mu over any number of freedoms. ``transient`` finds the
ticks at which the elbow moves to its optimum. Imports model and trace; planning, procedure and all rooms that draw or
compose import it.
"""
