"""The record of a run: its columns, its file, its ending, its metrics.

Read first: ``trace`` (``Trace``, one row a tick), ``columns`` (their units and meaning), then ``metrics`` (one function
a metric; add yours there). ``parquet`` and ``parquet_file`` are its files, ``writer`` writes it while the run grows,
``ending`` and ``oscillation`` say whether the run was a success. Imports ``errors``, ``inputs`` and,
when a trace is plotted, ``figures``; any room above may import it.
"""
