"""Planning over the redundancy: many poses have the required tip and wrist, and a course takes one at each time.

``self_motion`` traces the curve of poses with the same tip and wrist and counts the freedoms; ``elbow`` measures the
elbow's angle on it. For a path there are ``course`` (targets, and a joint trajectory along them), ``pose_map`` (every
pose at every time), ``search`` (V, the best integral of mu from a pose on), ``program`` (makes a course smooth), and
``plan`` (all of this before a run). In the loop, ``follow`` follows courses of ``guides``. ``swivel_map`` maps runs.

An ideal climb of mu from 59 random poses of the LWR4+ has a mean mu below that of the best course from the same start,
by 5.6 % on average and 41 % at worst. In the loop, ``local`` loses 7.8 and 52 %, ``planned`` (one course, made before
the run) 0.9 and 3.7 %, ``receding`` (the same program over one second, from the measured pose) 1.1 and 3.9 %. These two
lose mu because of the limits of their courses (docs/planning.md).
"""
