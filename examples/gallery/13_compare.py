"""
Solvers on the same random trials
=================================

Compare solvers in closed loop with each other and with DCAC. Two trials are too few for a conclusion.
"""

import moc_opt as mo

trial = mo.Scenario(start={"pose": "random", "swivel": "random"}, duration_s=3.0, bound_samples=0)
found = mo.compare(["exact", "proxqp", "rnn"], trial, trials=2)
print(found)

# %%
found.plot()
