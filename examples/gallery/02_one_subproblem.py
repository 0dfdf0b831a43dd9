"""
One subproblem, one judged answer
=================================

Build the problem of one tick by hand, solve it, and judge the answer by its residuals. The loss is 0 at the smallest
feasible cost and 1 at the largest.
"""

import numpy as np

import moc_opt as mo

robot = mo.load_robot("lwr4")
state = robot.state(robot.data.q_home)
qp = mo.NullSpaceQP(
    state.J_tip, state.J_wrist, v_tip=[0.01, 0.0, 0.0], v_wrist=[0.01, 0.0, 0.0],
    grad_mu=state.grad_mu, lower=-robot.v_max, upper=robot.v_max,
)  # fmt: skip
solution = mo.solvers.create("exact").start(qp).solve(qp)
residuals = qp.residuals(solution.x, solution.y)
print("x [rad/s]", np.round(solution.x, 4))
print(f"|A x - b| {residuals.primal:.1e}, natural residual {residuals.natural:.1e}, loss {residuals.loss:.1e}")
print("verified:", residuals.verified())

# %%
# A wrong answer is detected even if it satisfies every constraint.
kernel = np.linalg.svd(qp.A)[2][5:]
uphill = kernel.T @ (kernel @ state.grad_mu)
wrong = solution.x - 0.3 * uphill / np.linalg.norm(uphill)
print("moves tip and wrist as asked:", bool(np.abs(qp.A @ wrong - qp.b).max() < 1e-9))
print(f"verified: {qp.residuals(wrong, None).verified()}, loss {qp.residuals(wrong, None).loss:.2f}")
