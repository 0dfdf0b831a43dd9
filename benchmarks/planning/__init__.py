"""What `python -m benchmarks.plan` is made of: ``runs``, ``verdict`` and ``page``."""
