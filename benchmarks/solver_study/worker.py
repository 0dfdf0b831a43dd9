"""Workers of the study; see `benchmarks.processes` and `benchmarks.crew`."""

from benchmarks.crew import spread
from benchmarks.processes import START_S, Crashed, Hung, Raised, Worker, WorkerError, beat

__all__ = ["START_S", "Crashed", "Hung", "Raised", "Worker", "WorkerError", "beat", "spread"]
