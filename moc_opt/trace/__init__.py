"""The trace (record) of a run, its file, its metrics and its oscillations."""
