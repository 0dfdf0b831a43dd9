"""The null-space subproblem. Read ``problem`` first, then ``residuals``."""
