"""The solver study: what `python -m benchmarks.solvers` is made of.

Read first: ``study`` (what is asked for, and the parts in their order), then the two halves. Open loop: ``open_parts``,
with ``open_loop`` (recorded subproblems), ``answers`` and ``solving`` (ask and time a solver, in a worker) and
``growth``. Closed loop: ``closed_parts``, with ``cases`` (the trials), ``closed_loop`` (the runs), ``combine`` and
``sweeps``. ``settings`` has every solver's settings and why. From numbers to words: ``cells``, ``compare``,
``verdicts`` and ``headline``. ``columns``, ``tables``, ``figures``, ``first_screen``, ``look``, ``report`` and
``progress`` show them. Whoever adds a file that decides what a part contains adds it to ``study.SOURCES`` too:
otherwise parts of an earlier run are taken as they are.
"""
