"""The parts of `python -m benchmarks.plant`: its ``runs``, and the ``page`` with what they show."""
