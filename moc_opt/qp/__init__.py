"""The null-space subproblem as data, and the residuals of its answers.

Read first: ``problem`` (``NullSpaceQP``: cost, rows, box), then ``residuals`` (how every solver's answer is measured;
``extremes`` finds best and worst cost with several freedoms). This package imports no robot and no solver.
"""
