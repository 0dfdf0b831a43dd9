"""Planning over the redundancy: the poses that leave tip and wrist in place, and which to take when along a path.

``self_motion`` has the curve of poses with one tip and wrist, and the freedoms, ``elbow`` the angle of the elbow on it.
For a path there are ``course`` (targets, and a course along them), ``pose_map`` (every pose at every time), ``search``
(V, what a pose is worth to the end), ``program`` (a course made smooth) and ``plan`` (all of it before a run); in the
loop ``follow``. ``swivel_map`` shows runs on mu over time and swivel.

What each part buys, in mean mu below the best course from the same start, at 59 random poses of the LWR4+: an ideal
climb of mu ends 5.6 % below in the mean and 41 % at worst. In the loop ``local`` ends 7.8 and 52 % below, ``planned``
(one course, made before the run) 0.9 and 3.7 %, ``receding`` (the same program over a second, from the measured pose)
1.1 and 3.9 %. What is left is the price of the limits that a course keeps (docs/planning.md).
"""
