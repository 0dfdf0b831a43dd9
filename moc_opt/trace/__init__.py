"""The trace of a run: its file, metrics and oscillations."""
