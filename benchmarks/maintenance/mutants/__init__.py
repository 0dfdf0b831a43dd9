"""Small errors put into the source on purpose: what `python -m benchmarks.mutation` is made of."""
