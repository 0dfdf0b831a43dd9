"""Sweeps that survive: what `python -m benchmarks.sweep` is made of.

Read first: ``plan`` (which runs a sweep consists of; ``fields`` says what may vary), then ``engine`` (who does them)
over ``local`` or ``dask``, and ``store`` (what is finished stays finished; ``record`` is one run of it, ``version`` the
code that made it). ``summary`` reads the finished rows, ``table`` and ``report`` show them. ``config`` is the TOML,
``errors`` what can go wrong with a sweep as a whole.
"""
