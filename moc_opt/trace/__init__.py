"""What a run leaves behind: its columns, its file, its ending, its metrics.

Read first: ``trace`` (``Trace``: the columns with their units, one row a tick), then ``metrics`` (one
function a metric; add yours there). ``parquet`` is the file, ``writer`` writes it while the run grows,
``ending`` and ``oscillation`` say whether the run was a success. Imports ``errors`` and ``inputs`` alone; any
room above may import it.
"""
