"""The null-space subproblem as data, and the residuals of its answers.

Read first: ``problem`` (``NullSpaceQP``: cost, rows, box, validated and read-only), then ``residuals`` (how every
solver's answer is measured, without asking a solver; ``extremes`` finds best and worst cost with several freedoms).
``layout`` says where the parts of a packed subproblem lie, ``reduction`` takes six rows to five, ``equalities``
compiles both for solvers, and ``residual_kernels`` the residuals of a recording. Imports ``errors`` and ``numerics``,
and numpy alone but in the last two (numba); knows no robot and no solver.
"""
