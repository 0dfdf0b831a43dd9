"""The self-motion: the poses that are left to an arm while tip and wrist stay, and manipulability along them.

Read first: ``self_motion`` (the curve of one pose, scanned; ``continuation`` holds its kernels), then
``manipulability_map`` (mu over time and elbow swivel; ``arm_angle`` is the swivel) and ``map_analysis`` (what
the trajectories of runs on it amount to). ``ascent`` climbs mu over any number of freedoms. ``transient`` finds the
ticks at which the elbow is on its way. Imports model and trace; planning, procedure and whatever draws or composes
import it.
"""
