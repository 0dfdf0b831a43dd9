"""What `moc-opt` does: one module a kind of command, imported when it is asked for.

``running`` runs a scenario, ``ahead`` plans it, ``wire`` runs plant and controller as two processes, ``listing``
prints names, ``reference`` every key of a scenario, ``studies`` compares solvers and starts the benchmarks,
``reports`` and ``pages`` make pages of saved runs, and ``exporting`` writes C. Read first: ``parser``, which has
every command's arguments (with ``arguments``) and the table of which function does it.
"""
