"""The parts of python -m benchmarks.robots: runs of one trial, and what follows from the rows."""
