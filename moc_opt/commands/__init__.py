"""The commands of `moc-opt`, imported when one of them is run.

Read first: ``parser``, which has every command's options as data, and the function that does it. ``running`` runs and
plans a scenario, ``pages`` writes files and pages, ``listing`` prints names and ``reference`` every key of a scenario,
``studies`` compares solvers.
"""
