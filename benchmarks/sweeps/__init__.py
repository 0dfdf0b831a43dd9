"""Sweeps that survive: what `python -m benchmarks.sweep` is made of."""
