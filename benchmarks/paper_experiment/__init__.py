"""The parts of `python -m benchmarks.paper`: ``trials``, ``procedure``, ``verdict`` and ``page``.

To add a controller: a line of the TOML; to add a claim: ``verdict``.
"""
