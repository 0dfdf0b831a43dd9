"""
Another arm
===========

Run the same scenario on every arm of the package. Gains, limits and home pose come from the robot's file.
"""

import moc_opt as mo

for name in ("lwr4", "iiwa14", "panda", "gen3", "xarm7", "lwr4_rail"):
    trial = mo.Scenario(robot={"name": name}, duration_s=3.0, bound_samples=0, judge=False)
    found, baseline = mo.run(trial), mo.run(trial.change(control={"law": "dcac"}))
    summary = mo.summarize(found, baseline)
    print(
        f"{name:10s} {found.q_rad.shape[1]} joints, mu {summary['mu_gain_percent']:+5.1f} %, "
        f"RCM {summary['rcm_error_model_mean_mm']:.3f} mm, {found.meta['ended']}"
    )
