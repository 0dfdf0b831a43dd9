"""
Two solvers on the same robot
=============================

Compare `exact` with the recurrent network of the 2019 paper, in the same controller on the same trial.
"""

import moc_opt as mo
from moc_opt.figures.series import time_series

trial = mo.Scenario(seed=1, start={"swivel": "random"}, duration_s=6.0)
runs = {name: mo.run(trial.change(solver={"name": name, "settings": {}})) for name in ("exact", "rnn")}
baseline = mo.run(trial.change(control={"law": "dcac"}))

for name, trace in runs.items():
    found = mo.summarize(trace, baseline)
    print(
        f"{name:6s} mu {found['mu_gain_percent']:+.1f} %, "
        f"verified {found['verified_solved']:.0f} of {len(trace)} answers, "
        f"tip {found['tip_error_model_mean_mm']:.3f} mm"
    )

# %%
# The network's answers lag behind the optimum.
time_series({**runs, "dcac": baseline})
