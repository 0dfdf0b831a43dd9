"""Before a run: check whether the task can be done, and register the trocar.

Read first: ``preflight`` (checks a start and a path, draws random starts), then ``reachability`` (follows a
path by kinematics alone). ``hands_on`` registers the trocar by guiding the tool by hand. Imported by scenario
and benchmarks; imports control and sim for the guiding, no solver.
"""
