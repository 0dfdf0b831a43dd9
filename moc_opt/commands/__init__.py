"""The commands of `moc-opt`: one module per kind, imported when one of its commands is run.

``running`` runs a scenario, ``ahead`` plans it, ``wire`` runs plant and controller as two processes, ``listing``
prints names, ``reference`` every key of a scenario, ``studies`` compares solvers and starts the benchmarks, and
``reports`` makes a page of saved runs. ``arguments`` has the arguments of most, for the parser of ``moc_opt.__main__``.
"""
