"""
Plan a path before anything moves
=================================

A plan tells whether the whole path can be executed from a start. It contains the best course, and an estimated upper
bound on the mean manipulability mu.
"""

import moc_opt as mo

scenario = mo.Scenario(seed=7, start={"pose": "random"}, task={"path": "sinusoid"})
plan = mo.plan(scenario)
print("executable:", plan.executable)
print(f"mean mu of the best course from this start {plan.from_start.mu.mean():.4f} m^3")
print(f"estimated upper bound from this start      {plan.bound_from_start:.4f} m^3")
print(f"a local climb reaches                      {plan.climbed.mu.mean():.4f} m^3")
print(f"the best course over all starts            {plan.best.mu.mean():.4f} m^3")
