"""The record of a run: its columns, its file, its ending, its metrics.

Read first: ``trace`` (``Trace``, one row a tick), ``columns`` (their units and meaning), then ``metrics`` (one function
a metric; add yours there), which ``registry`` computes. ``file`` is its Parquet file, ``meta`` has the types of its
other entries and how a run ended, ``oscillation`` whether an arm shook. Imports ``errors``, ``inputs`` and, when a
trace is plotted, ``figures``; any room above may import it.
"""
