"""
Follow a plan instead of climbing
=================================

The local law climbs the manipulability mu from the start, and may stay at a lower local maximum. The planned law
follows the motion with the best mean mu over the path.
"""

import moc_opt as mo
from moc_opt.figures.series import time_series

trial = mo.Scenario(seed=26, start={"pose": "random", "swivel": "random"}, bound_samples=0)
runs = {level: mo.run(trial.change(control={"third_level": level})) for level in ("local", "planned")}
best = runs["planned"].meta["course_mu_mean"]
for level, trace in runs.items():
    share = 100 * trace.mu.mean() / best
    print(f"{level:8s} mean mu {trace.mu.mean():.4f} m^3, {share:.1f} % of the planned course")

# %%
time_series(runs, ["mu", "tip_error_m", "rcm_error_m"])
