"""Planning over the redundancy: which elbow swivel, on which branch, at which time along a path.

Read first: ``plan`` (the plan of a path before a run), then what it is made of: ``targets`` (tip and wrist that a path
asks for); ``spherical`` (arms whose poses have a closed form, with ``spherical_kernels``) and ``traced`` (all others)
for ``pose_map`` (every pose at every point of the path); ``search`` (dynamic programming over the map, with
``search_kernels``); ``refine`` (the whole horizon as one nonlinear program) and ``candidates`` (the courses that it
begins at); ``course`` (poses over time, and what they violate); ``shaft`` (a margin from losing the shaft); ``climb``
(the best of a local law); ``blocked`` (where a path ends). In the loop: ``follow`` (a course made before the run) and
``receding`` (one made again and again), with ``horizon`` (its nonlinear program) and ``to_go`` (V, the value of the
rest of the path). ``placement`` is one place of trocar or base, ``largest`` the largest mu at given points, of any arm.
Imports model, redundancy and tasks; scenario and report import it.
"""
