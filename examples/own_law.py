"""A control law of your own in the closed loop: the three levels of Su et al. (2019) in numpy, without a solver.

The third level follows the gradient of mu, projected onto the self-motion, which moves neither tip nor wrist.

python examples/own_law.py
"""

import numpy as np
from scipy.linalg import null_space

import moc_opt as mo
from moc_opt.scenario.setup import Setup


class OwnLaw:
    """A controller needs only these methods."""

    K_X, D_X, K_N, D_N, K_N2 = 3000.0, 30.0, 800.0, 10.0, 15.0
    CLIMB = 30.0  # joint velocity per unit of the gradient of mu

    def __init__(self, robot):
        self.robot, self.tip = robot, np.zeros(3)

    def start(self, q, v, tip_ref, trocar):
        """Do nothing."""

    def tick(self, q, v, tip_ref, trocar):
        """Return the torque (n,) [Nm] for the measured q (n,) [rad] and v (n,) [rad/s]."""
        s = self.robot.state(q, v)
        self.tip = s.tip
        (X_d, dX_d, _), (P, dP) = tip_ref, trocar
        J, W, M = s.J_tip, s.J_wrist, s.M
        M_inverse = np.linalg.inv(M)

        # Level 1: a spring and damper pull the tip to its reference. s.h compensates gravity and Coriolis torques.
        tau_tip = s.h + J.T @ (self.K_X * (X_d - s.tip) + self.D_X * (dX_d - J @ s.v))

        # Level 2: in the null space of level 1, the wrist is pulled to N_d, which puts the shaft through the trocar.
        to_trocar = P - s.tip
        e = to_trocar / np.linalg.norm(to_trocar)
        relative = dP - J @ s.v
        N_d = s.tip + s.tool_span * e
        dN_d = J @ s.v + s.tool_span * (relative - (e @ relative) * e) / np.linalg.norm(to_trocar)
        J_bar = M_inverse @ J.T @ np.linalg.inv(J @ M_inverse @ J.T)
        tau_rcm = (np.eye(s.n) - J.T @ J_bar.T) @ W.T @ (self.K_N * (N_d - s.wrist) + self.D_N * (dN_d - W @ s.v))

        # Level 3: the elbow moves towards larger mu.
        Z = null_space(np.vstack([J, W]), rcond=1e-7).T
        x = np.clip(self.CLIMB * Z.T @ (Z @ s.grad_mu), -0.5, 0.5)
        tau_mu = M @ Z.T @ np.linalg.inv(Z @ M @ Z.T) @ Z @ (self.K_N2 * (x - s.v))
        return tau_tip + tau_rcm + tau_mu

    def set_applied_torque(self, tau):
        """Do nothing: this law has no observer."""

    def columns(self, ticks):
        """Add no columns to the trace."""
        return {}

    def note(self, row, columns):
        """Do nothing."""


class OwnSetup(Setup):
    def controller(self):
        return OwnLaw(self.robot)


def main():
    scenario = mo.Scenario(duration_s=4.0, start={"swivel": 0.2}, judge=False)
    for name, trace in {"own law": OwnSetup(scenario).trace(), "moc_opt": mo.run(scenario)}.items():
        found = mo.summarize(trace)
        figures = ", ".join(f"{key} {found[key]:.3f}" for key in ("mu_mean", "tip_error_mean_mm", "rcm_error_mean_mm"))
        print(f"{name}: {trace.meta['ended']}, {figures}, tick p50 {found['tick_p50_us']:.0f} us")


if __name__ == "__main__":
    main()
