"""What ``python -m benchmarks.sweep`` varies.

Read first: ``config`` (the TOML), ``fields`` (what may be varied, and over which values), ``plan`` (the runs), then
``report`` (tables, page and headline).
"""
