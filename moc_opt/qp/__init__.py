"""The null-space subproblem, which chooses the joint velocity at a given tip and wrist velocity, and its residuals.

Read first: ``problem`` (``NullSpaceQP``: cost, equality rows, bounds), then ``residuals`` (how far an answer is from
optimal). ``extremes`` finds the best and worst cost if ker A has several dimensions. No robot or solver is imported.
"""
