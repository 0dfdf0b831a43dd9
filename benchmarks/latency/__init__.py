"""Where the time goes: what `python -m benchmarks.speed` is made of."""
