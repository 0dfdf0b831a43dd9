"""Planning over the redundancy: what an arm may do while tip and wrist stay, and which of it, when, along a path.

``self_motion`` has the curve of poses with one tip and wrist, and how many freedoms there are; ``elbow`` the angle of
the elbow on it. For a path: ``course`` (targets, and a course along them), ``pose_map`` (every pose at every time),
``search`` (V, what a pose is worth to the end), ``program`` (a course improved and made smooth), ``plan`` (all of it
before a run). In the loop: ``follow``. ``swivel_map`` shows runs on mu over time and swivel. Imports core, robots,
tasks and trace.

What each part buys, in mean mu below the best course from the same start, at 11 random poses of the LWR4+ on which
nothing was tuned (seed 9100), in the mean and at worst: an ideal climb of mu is 7.4 and 36 % below; the map and one
search over it leave 0.40 and 2.1 %; the program over the whole path takes these away, and makes a course smooth enough
to be followed. In the loop, within the limits of a followed course: ``local`` 8.1 and 37 %, ``planned`` (one course,
made before the run) 1.1 and 3.7 %, ``receding`` (the same program over a second, from the measured pose) 0.7 and 4.1 %.
"""
