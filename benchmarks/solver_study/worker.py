"""Workers of the study; see `benchmarks.processes`."""

from benchmarks.processes import START_S, Crashed, Hung, Raised, Worker, WorkerError, beat, spread

__all__ = ["START_S", "Crashed", "Hung", "Raised", "Worker", "WorkerError", "beat", "spread"]
