"""
Solvers on the same random trials
=================================

Compare solvers in closed loop. The seed of each trial draws its start, and DCAC with the same gains runs every trial,
too. From eight trials on, means have 95 % intervals. Two trials are too few for a verdict.
"""

import moc_opt as mo

trial = mo.Scenario(start={"pose": "random", "swivel": "random"}, duration_s=3.0, bound_samples=0)
found = mo.compare(["exact", "proxqp", "rnn"], trial, trials=2)
print(found)

# %%
found.plot()
