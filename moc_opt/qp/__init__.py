"""The null-space subproblem, which chooses the joint velocity at a given tip and wrist velocity.

Read ``problem`` first, then ``residuals``, which measure how far an answer is from the optimum.
"""
