"""The record of a run: its columns, its file, its ending, its metrics.

Add a metric: one function under ``@metric`` in ``metrics``. Read first: ``trace`` (``Trace``, one row a tick) and
``columns`` (their units and meaning). ``file`` is the Parquet file, ``meta`` has the other entries and how a run ended,
``oscillation`` whether an arm shook. Any room above may import it.
"""
