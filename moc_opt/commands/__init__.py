"""The commands of `moc-opt`, imported when one of them is run.

Read first: ``parser``, which has the options and the function of every command as data. ``running`` runs and plans a
scenario, ``making`` writes files and pages and compares solvers, ``listing`` prints names, and ``reference`` prints
every key of a scenario.
"""
