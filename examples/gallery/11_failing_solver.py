"""
A bad answer does no harm
=========================

At one tick in five, the solver here lowers the manipulability instead of raising it, and claims success. The
supervisor refuses these answers and replaces them.
"""

import moc_opt as mo

trial = mo.Scenario(seed=4, start={"swivel": 0.2}, duration_s=4.0, bound_samples=0)
for rate in (0.0, 0.2):
    trace = mo.run(trial.change(faults={"solver": "lie", "solver_share": rate}))
    found = mo.summarize(trace)
    print(
        f"wrong at {100 * rate:2.0f} % of the ticks: {trace.meta['ended']}, mu {found['mu_mean']:.4f}, "
        f"tip {found['tip_error_model_mean_mm']:.3f} mm, RCM {found['rcm_error_model_mean_mm']:.3f} mm"
    )
