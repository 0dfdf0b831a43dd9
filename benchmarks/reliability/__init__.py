"""Faults and bad input: what `python -m benchmarks.faults` and `python -m benchmarks.fuzz` are made of.

For ``faults``: ``config`` (which faults), ``runs`` (one controller under each of them), ``summary`` (the goals),
``report``. For ``fuzz``: ``fuzz_case`` (what every check shares), ``fuzz_checks`` and ``fuzz_file_checks`` (what must
hold), ``limits`` (a process for each case); the other ``fuzz_*`` make one kind of input each. ``page`` writes
docs/reliability.md from both.
"""
