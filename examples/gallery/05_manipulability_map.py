"""
Where there is manipulability to gain
=====================================

The map shows all poses with the tip on its path and the shaft through the trocar, over time and
swivel. Colour shows mu. Poses beyond a joint limit are grey. Each line is a run.
"""

import moc_opt as mo
from moc_opt.planning.swivel_map import manipulability_map, read_trajectory
from moc_opt.report.map_page import map_figure

trial = mo.Scenario(seed=5, start={"pose": "random", "swivel": "random"}, duration_s=5.0, bound_samples=0)
runs = {"exact": mo.run(trial), "dcac": mo.run(trial.change(control={"law": "dcac"}))}
found = manipulability_map(mo.load_robot("lwr4"), runs)
for name in runs:
    reading = read_trajectory(found, name)
    print(f"{name}: {reading.end}; mean mu is {100 * reading.mu_share:.0f} % of the best")

# %%
map_figure(found)
