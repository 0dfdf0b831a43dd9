"""The null-space subproblem as data, and the judge of its answers.

Read first: ``problem`` (``NullSpaceQP``: cost, rows, box, validated and read-only), then ``residuals`` (how
every solver's answer is judged; the judge asks no solver). ``extremes`` finds best and worst cost with
several freedoms, ``equalities`` packs the six or five rows for solvers. Imports ``errors`` alone, and numpy
alone but in ``equalities`` (numba); knows no robot and no solver.
"""
