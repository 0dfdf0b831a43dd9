"""What `moc-opt` does beside running scenarios: lists of what there is, the scenario's keys, reports, comparisons.

``listing`` prints names, ``reference`` every key of a scenario, ``studies`` compares solvers and starts the benchmarks,
``reports`` makes a page of saved runs. ``arguments`` has the arguments of all, for the parser of ``moc_opt.__main__``.
"""
