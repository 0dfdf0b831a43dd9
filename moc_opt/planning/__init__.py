"""Courses of redundant arms.

- ``self_motion`` traces the poses with the same tip and wrist. ``elbow`` measures the swivel.
- ``pose_map`` computes the poses along a path, ``search`` finds the best course on the map, and ``program`` smooths it.
- ``plan`` plans a path, ``guides`` makes the courses of a run, and ``follow`` follows them.
"""
