"""The null-space subproblem, which chooses the joint velocity at a given tip and wrist velocity, and its residuals.

Read first: ``problem`` (``NullSpaceQP``: cost, equality rows A x = b, bounds), then ``residuals`` (how far an answer is
from optimal). ``extremes`` finds the smallest and largest cost if ker A has several dimensions.
"""
