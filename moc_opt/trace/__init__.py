"""The record of a run: ``trace`` (``Trace``, one row a tick), ``columns`` (their units and meaning) and ``metrics``.

``file`` reads and writes Parquet; ``meta`` has the entries besides the columns; ``oscillation`` finds arms that shake.
"""
