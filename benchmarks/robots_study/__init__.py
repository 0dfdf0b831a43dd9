"""The parts of python -m benchmarks.robots: runs of one trial, and the evaluation of the rows."""
