"""The null-space subproblem and the check of its answers. Read ``problem`` first, then ``residuals``."""
