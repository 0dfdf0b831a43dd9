"""
A solver of your own
====================

A solver has settings and the methods `supports` and `start`. `start` returns a session, whose method `solve` answers
problems. This solver is its own session. It follows the self-motion until a joint reaches its bound. For an arm with
seven joints, this point is the optimum without regularization.
"""

from dataclasses import dataclass

import numpy as np

import moc_opt as mo
from moc_opt.solvers.base import Solution, Status


@dataclass(frozen=True)
class Walk:
    name = "walk"

    def supports(self, qp):
        return None if len(qp.lower) == 7 else "it needs an arm with seven joints"

    def start(self, qp):
        return self

    def solve(self, qp):
        x = np.linalg.lstsq(qp.A, qp.b, rcond=None)[0]
        kernel = np.linalg.svd(qp.A)[2][5:]
        downhill = -kernel.T @ (kernel @ (qp.P @ x + qp.p))
        moves = np.abs(downhill) > 1e-9 * np.abs(downhill).max()
        wall = np.where(downhill > 0, qp.upper, qp.lower)
        step = ((wall - x)[moves] / downhill[moves]).min()
        return Solution(x + step * downhill, None, Status.SOLVED, 1)


robot = mo.load_robot("lwr4")
state = robot.state(robot.data.q_home)
qp = mo.NullSpaceQP(
    state.J_tip, state.J_wrist, v_tip=[0.01, 0.0, 0.0], v_wrist=[0.01, 0.0, 0.0], grad_mu=state.grad_mu,
    lower=-robot.v_max, upper=robot.v_max, regularization=0.0,
)  # fmt: skip
for solver in (Walk(), mo.solvers.create("exact")):
    solution = solver.start(qp).solve(qp)
    print(solver.name, np.round(solution.x, 4), "verified:", qp.residuals(solution.x, solution.y).verified())
