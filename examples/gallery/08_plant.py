"""
What a defect of the robot costs
================================

The realistic plant differs from the controller's model in masses, friction, delay, noise and calibration.
"""

import moc_opt as mo

plants = {
    "nominal: the model itself": {"preset": "nominal"},
    "realistic": {"preset": "realistic"},
    "realistic, no friction": {"preset": "realistic", "friction": 0.0},
    "realistic, 3 ticks of delay": {"preset": "realistic", "delay_ticks": 3},
}
for name, plant in plants.items():
    trace = mo.run(mo.Scenario(seed=2, plant=plant, duration_s=4.0, bound_samples=0, judge=False))
    found = mo.summarize(trace)
    print(
        f"{name:30s} tip {found['tip_error_model_mean_mm']:.3f} mm, RCM {found['rcm_error_model_mean_mm']:.3f} mm, "
        f"chatter {found['torque_rate_rms_Nm_per_s']:.0f} Nm/s"
    )
