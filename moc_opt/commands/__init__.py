"""The commands of `moc-opt`, imported when one of them is run.

Read first: ``parser``, which has every command's options as data, and the function that does it. ``running`` runs and
plans a scenario, ``making`` writes files and pages and compares solvers, ``listing`` prints names and ``reference``
every key of a scenario.
"""
