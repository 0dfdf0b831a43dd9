"""What `python -m benchmarks.faults` is made of: ``runs``, ``verdict`` and ``page``."""
