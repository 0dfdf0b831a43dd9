"""Faults and bad input: what `python -m benchmarks.faults` and `.fuzz` are made of."""
