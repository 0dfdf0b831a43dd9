"""Planning for redundant arms. Many poses place tip and wrist as required; a course is a trajectory of such poses.

- ``self_motion`` traces the curve of poses with the same tip and wrist. ``elbow`` measures the elbow's angle.
- ``course`` defines the targets along a path, and courses. ``pose_map`` computes every pose at every time.
- ``search`` finds the best course on the map, ``program`` smooths it, and ``plan`` plans a path before a run.
- ``guides`` makes the courses of a run, and ``follow`` follows them. ``swivel_map`` shows runs on a map of mu.

In runs from 60 random starts of the LWR4+, mean mu (manipulability) was below that of the best course. The gap was 8 %
(at worst 52 %) if the controller only climbed mu. It was 0.9 % (at worst 3.7 %) with a course made before the run, and
1.1 % (at worst 3.9 %) with courses made during the run (docs/planning.md).
"""
