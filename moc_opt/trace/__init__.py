"""The record of a run: ``trace`` (``Trace``, one row a tick), ``columns`` (their units and meaning) and ``metrics``.

``file`` is the Parquet file, ``meta`` has the other entries and how a run ended, ``oscillation`` whether an arm shook.
"""
