"""Solvers in the same controller on the same trials: `mo.compare`.

Read first: ``compare`` (how it is run), then ``findings`` (``Comparison``), ``trials`` (what is the same for all) and
``statistics`` (means and changes with their intervals). Stands on scenario and report; imported by the public names,
the command line and benchmarks.
"""
