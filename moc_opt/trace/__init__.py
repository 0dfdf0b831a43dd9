"""The trace of a run: ``trace`` (``Trace``, one row per control tick), ``columns`` (units, meaning) and ``metrics``.

``file`` reads and writes Parquet, ``meta`` has the entries about a whole run, and ``oscillation`` finds shaking joints.
"""
