"""Planning over the redundancy: which of the poses with the required tip and wrist to take at each time of a path.

``self_motion`` traces the curve of poses with one tip and wrist and counts the freedoms; ``elbow`` measures the elbow's
angle on it. For a path there are ``course`` (targets, and a course along them), ``pose_map`` (every pose at every
time), ``search`` (V, the value of a pose to the end of the path), ``program`` (makes a course smooth) and ``plan`` (all
of this before a run). In the loop, ``follow`` follows the courses that ``guides`` makes. ``swivel_map`` shows runs.

Mean mu below the best course from the same start, at 59 random poses of the LWR4+: an ideal climb of mu ends 5.6 %
below on average, 41 % at worst; in the loop ``local`` 7.8 and 52 %, ``planned`` (one course, made before the run) 0.9
and 3.7 %, ``receding`` (the same program over one second, from the measured pose) 1.1 and 3.9 %. The rest is the cost
of the limits that a course keeps (docs/planning.md).
"""
