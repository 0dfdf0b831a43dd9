"""The solver study: what `python -m benchmarks.solvers` is made of."""
