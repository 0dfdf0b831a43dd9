"""
Solvers on the same random trials
=================================

Compare solvers in closed loop. Every trial begins at a pose that its seed draws, and DCAC with the same gains runs it
too. A mean comes with its 95 % interval and the number of its trials; two are too few for a verdict.
"""

import moc_opt as mo

trial = mo.Scenario(start={"pose": "random", "swivel": "random"}, duration_s=3.0, bound_samples=0)
found = mo.compare(["exact", "proxqp", "rnn"], trial, trials=2)
print(found)

# %%
found.plot()
