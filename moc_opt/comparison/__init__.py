"""Solvers in the same controller on the same trials: `mo.compare`.

Read first: ``compare`` (runs the trials), then ``findings`` (``Comparison``), ``trials`` (the scenario of each) and
``statistics`` (means and changes with their intervals). Imports scenario and report; imported by the public names,
the command line and benchmarks.
"""
