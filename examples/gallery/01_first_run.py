"""
One run, and its metrics
========================

From a random start, an LWR4+ follows a circle with its tool through the trocar. The controller raises the
manipulability mu. The baseline (`dcac`) does not.
"""

import moc_opt as mo

scenario = mo.Scenario(seed=3, start={"pose": "random", "swivel": "random"}, duration_s=6.0)
trace = mo.run(scenario)
baseline = mo.run(scenario.change(control={"law": "dcac"}))

# %%
# The unit is in the metric's name.
summary = mo.summarize(trace, baseline)
for name in ("mu_mean", "mu_gain_percent", "tip_error_model_mean_mm", "rcm_error_model_mean_mm"):
    print(f"{name:26s} {summary[name]:8.3f}")
print(f"{'ended':26s} {trace.meta['ended']}")

# %%
# Both runs over time:
trace.plot(name="exact", beside=baseline)
