"""What `python -m benchmarks.robots` is made of: ``runs``, ``verdict`` and ``page``."""
