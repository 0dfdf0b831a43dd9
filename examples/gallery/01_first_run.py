"""
One run, and what it is worth
=============================

Run the default scenario: an LWR4+ follows a circle through the trocar, the third level is solved by `exact`.
The baseline is the same trial without the third level (`dcac`).
"""

import moc_opt as mo
from moc_opt.report.figures.series import time_series

scenario = mo.Scenario(seed=3, start={"pose": "random", "swivel": "random"}, duration_s=6.0)
trace = mo.run(scenario)
baseline = mo.run(scenario.change(control={"law": "dcac"}))

# %%
# A summary is a dictionary; the unit is in the metric's name.
summary = mo.summarize(trace, baseline)
for name in ("mu_mean", "mu_gain_percent", "tip_error_model_mean_mm", "rcm_error_model_mean_mm", "verified_solved"):
    print(f"{name:26s} {summary[name]:8.3f}")
print(f"{'ended':26s} {trace.meta['ended']}")

# %%
# Both runs over time:
time_series({"exact": trace, "dcac": baseline})
