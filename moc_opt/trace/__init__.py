"""The record of a run: ``trace`` (``Trace``, one row per tick), ``columns`` (units and meaning) and ``metrics``.

``file`` reads and writes Parquet; ``meta`` has the entries besides the columns; ``oscillation`` finds shaking arms.
"""
