"""Planning for redundant arms. A course is a joint trajectory that executes a path.

- ``self_motion`` traces the poses with the same tip and wrist. ``elbow`` measures the swivel.
- ``course`` defines targets and courses. ``pose_map`` computes the poses along a path.
- ``search`` finds the best course on the map, ``program`` smooths it, and ``plan`` plans a path before a run.
- ``guides`` makes the courses of a run, and ``follow`` follows them. ``swivel_map`` maps mu over time and swivel.
"""
