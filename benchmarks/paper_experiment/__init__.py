"""The experiment of the paper: what `python -m benchmarks.paper` is made of.

Read first: ``trials`` (every controller on the same start, plant and noise; one row a run), then ``verdict`` (which
claims hold, computed from the rows) and ``config`` (the TOML). ``ablation`` exchanges entries of Table I, ``swivel``
moves the start, ``procedure`` runs guiding, camera and task. ``first_screen``, ``tables``, ``figures``, ``look`` and
``report`` show what was found. To add a controller: a line of the TOML; to add a claim: ``verdict``.
"""
