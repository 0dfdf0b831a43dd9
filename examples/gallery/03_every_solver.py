"""
The same problem, every solver
==============================

Solve one subproblem with every installed solver, and judge all answers by the same residuals.
"""

import moc_opt as mo

robot = mo.load_robot("lwr4")
state = robot.state(robot.data.q_home)
qp = mo.NullSpaceQP(
    state.J_tip, state.J_wrist, v_tip=[0.01, 0.0, 0.0], v_wrist=[0.01, 0.0, 0.0],
    grad_mu=state.grad_mu, lower=-robot.v_max, upper=robot.v_max,
)  # fmt: skip
print(f"{'solver':26s}{'says':>12s}{'verified':>10s}{'primal':>10s}{'loss':>10s}")
for name, reason in mo.solvers.available().items():
    if reason is not None or name.startswith("nlp"):  # nlp-* answer the nonlinear problem of a tick
        continue
    solver = mo.solvers.create(name)
    if solver.supports(qp) is not None:
        continue
    solution = solver.start(qp).solve(qp)
    found = qp.residuals(solution.x, solution.y)
    print(f"{name:26s}{solution.status.name.lower():>12s}{found.verified()!s:>10s}{found.primal:10.0e}{found.loss:10.0e}")
