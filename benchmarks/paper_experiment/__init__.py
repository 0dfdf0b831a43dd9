"""The experiment of the paper: what `python -m benchmarks.paper` is made of."""
