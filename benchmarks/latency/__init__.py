"""Where the time goes: what `python -m benchmarks.speed` and `python -m benchmarks.realtime` are made of."""
