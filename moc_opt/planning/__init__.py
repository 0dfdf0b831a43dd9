"""Planning over the redundancy: which elbow swivel, on which branch, at which time along a path.

Read first: ``targets`` (tip and wrist that a path asks for), ``spherical`` (arms whose poses have a closed form) and
``pose_map`` (every pose at every point of the path), then ``search`` (dynamic programming over the map), ``refine``
(the whole horizon as one nonlinear program) and ``plan`` (the plan of a path before a run); ``largest`` is the
largest mu at given points, of any arm. Imports model, redundancy and tasks; scenario and report import it.
"""
