"""The null-space subproblem as data, and the judge of its answers."""
