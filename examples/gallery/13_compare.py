"""
Solvers on the same random trials
=================================

Compare solvers in closed loop. The seed of each trial draws its start, and DCAC with the same gains runs every trial,
too. Every mean has a 95 % interval and its count of trials; two trials are too few for a verdict.
"""

import moc_opt as mo

trial = mo.Scenario(start={"pose": "random", "swivel": "random"}, duration_s=3.0, bound_samples=0)
found = mo.compare(["exact", "proxqp", "rnn"], trial, trials=2)
print(found)

# %%
found.plot()
