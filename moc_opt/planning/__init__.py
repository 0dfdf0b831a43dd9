"""Planning for redundant arms, which can reach a point in many poses. A course is a planned joint motion.

- ``self_motion`` traces the poses that share the positions of tip and wrist. ``elbow`` measures the elbow's angle.
- ``course`` defines targets and courses. ``pose_map`` computes every pose at every time.
- ``search`` finds the best course on the map, ``program`` smooths it, and ``plan`` plans a path before a run.
- ``guides`` makes the courses of a run, and ``follow`` follows them. ``swivel_map`` maps manipulability and runs.
"""
