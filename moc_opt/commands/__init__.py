"""The commands of `moc-opt`: one module per kind, imported when one of its commands is run.

Read first: ``parser``, which has every command's arguments and the table of which function does it. ``running`` runs
and plans a scenario, ``wire`` runs plant and controller as two processes, ``pages`` writes files and pages,
``listing`` prints names, ``reference`` every key of a scenario, ``studies`` compares solvers and starts the benchmarks.
"""
