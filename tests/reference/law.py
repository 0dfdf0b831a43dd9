"""The control law of docs/method.md in plain numpy, from a RobotState s and the trocar's position P, velocity dP."""

import numpy as np
from scipy.linalg import null_space as scipy_null_space

# See moc_opt/core/law.c and null_space.c.
STRAIGHT, SHAFT_PULL, SHAFT_LOST, BOX_OPENS = 1e-3, 0.1, 0.1, 3.0
CLIMB_PER_S, LONGEST_RAD, PROBE_RAD = 5.0, 1.0, 1e-3


def towards_trocar(X, dX, P, dP):
    """Return (|P - X|, e, d|P - X|/dt, de/dt) with e = (P - X) / |P - X|."""
    r, dr = P - X, dP - dX
    e = r / np.linalg.norm(r)
    return np.linalg.norm(r), e, e @ dr, (dr - (e @ dr) * e) / np.linalg.norm(r)


def desired_wrist(X, dX, P, dP, L):
    """Return (N_d, dN_d), the wrist's desired position X + L e and velocity dX + L de/dt."""
    _, e, _, de = towards_trocar(X, dX, P, dP)
    return X + L * e, dX + L * de


def desired_wrist_acceleration(X, dX, ddX, P, dP, L):
    """ddN_d = ddX + L e'', with r = P - X, r'' = -ddX and e'' = (I - e e^T)(r'' - 2 |r|' e') / |r| - |e'|^2 e."""
    distance, e, closing, de = towards_trocar(X, dX, P, dP)
    pull = -ddX - 2.0 * closing * de
    return ddX + L * ((pull - (e @ pull) * e) / distance - (de @ de) * e)


def null_space(A):
    """Return orthonormal rows (r, n) that span the null space of A."""
    return scipy_null_space(A, rcond=1e-7).T


def projector(name, s):
    """Return the projector (n, n) of level 2."""
    J, eye = s.J_tip, np.eye(s.n)
    if name == "as_published":
        return eye - J.T @ J
    if name == "static":
        return eye - J.T @ np.linalg.pinv(J).T
    M_inverse = np.linalg.inv(s.M)
    J_bar = M_inverse @ J.T @ np.linalg.inv(J @ M_inverse @ J.T)
    return eye - J.T @ J_bar.T


def tip_torque(s, K_X, D_X, tip_ref):
    """tau_tip = h + J_T^T (K_X (X_d - X) + D_X (dX_d - J_T v))."""
    X_d, dX_d, _ = tip_ref
    return s.h + s.J_tip.T @ (K_X * (X_d - s.tip) + D_X * (dX_d - s.J_tip @ s.v))


def rcm_torque(s, K_N, D_N, trocar, projector_name="dynamic", rcm_lambda=None):
    """tau_rcm = (I - J_T^T Jbar_T^T) J_W^T (K_N (N_d - N) + D_N (dN_d - J_W v))."""
    P, dP = trocar
    N_d, dN_d = desired_wrist(s.tip, s.J_tip @ s.v, P, dP, s.tool_span)
    error = N_d - s.wrist
    if rcm_lambda:  # scale the wrist error to the length d / lambda, where d = |(P - X) x u| is the RCM error
        error *= np.linalg.norm(np.cross(P - s.tip, s.tool_direction)) / rcm_lambda / np.linalg.norm(error)
    F = K_N * error + D_N * (dN_d - s.J_wrist @ s.v)
    return projector(projector_name, s) @ s.J_wrist.T @ F


def feedforward(s, tip_ref, trocar):
    """Return the torque J_T^T F_T + B^T F_W with A M^-1 A^T [F_T; F_W] = [a_T; a_W] and A = [J_T; B].

    B (2, n) is J_W projected on two directions across the shaft. a_T and a_W are the desired accelerations of tip and
    wrist minus the drifts. F_W leaves out a direction in which the wrist hardly moves while the tip rests.
    """
    J, B = s.J_tip, scipy_null_space(s.tool_direction[None]).T @ s.J_wrist
    M_inverse = np.linalg.inv(s.M)
    Lambda = np.linalg.inv(J @ M_inverse @ J.T)
    ddN_d = desired_wrist_acceleration(s.tip, J @ s.v, tip_ref[2], *trocar, s.tool_span)
    a_T = tip_ref[2] - s.drift_tip
    a_W = scipy_null_space(s.tool_direction[None]).T @ (ddN_d - s.drift_wrist)
    coupling = B @ M_inverse @ J.T
    yields, along = np.linalg.eigh(B @ M_inverse @ B.T - coupling @ Lambda @ coupling.T)
    used = yields > STRAIGHT**2 * yields.max()
    F_W = along[:, used] @ ((along[:, used].T @ (a_W - coupling @ Lambda @ a_T)) / yields[used])
    return J.T @ Lambda @ (a_T - coupling.T @ F_W) + B.T @ F_W


def velocity_damper(q, q_min, q_max, v_max, k0):
    """Return -k0 (q - q_min) and -k0 (q - q_max), both clipped to [-v_max, v_max]."""
    lower = np.clip(-k0 * (q - q_min), -v_max, v_max)
    return lower, np.clip(-k0 * (q - q_max), -v_max, v_max)


def references(s, tip_ref, trocar):
    """Return the reference velocities (v_T, v_W) of tip and wrist, with u^T (v_T - v_W) = 0."""
    v_T, u = tip_ref[1], s.tool_direction
    _, v_W = desired_wrist(s.tip, v_T, *trocar, s.tool_span)
    return v_T, v_W + u * (u @ (v_T - v_W))


def shaft_push(mu_shaft, margin):
    """Return the weight of grad mu_shaft in `slope`."""
    if mu_shaft >= margin:
        return 0.0
    return SHAFT_PULL * (1.0 - mu_shaft / margin) * mu_shaft / (mu_shaft**2 + (SHAFT_LOST * margin) ** 2)


def slope(s, margin=0.0):
    """Return Z^T Z (grad mu + w grad mu_shaft), a vector in ker A. The weight w is `shaft_push`."""
    Z = null_space(s.A)
    return Z.T @ Z @ (s.grad_mu + shaft_push(s.mu_shaft, margin) * s.grad_mu_shaft)


def scaled_climb(robot, s, margin=0.0):
    """x_d = k z |g| / max(-b, |g| / r), a Newton step to the maximum of mu along z = g / |g|.

    g is `slope`, b is the derivative of g^T z along z, k is CLIMB_PER_S, and r is LONGEST_RAD.
    """
    g = slope(s, margin)
    steep = np.linalg.norm(g)
    if not steep > 1e-12:
        return np.zeros(s.n)
    z = g / steep
    bend = (slope(robot.state(s.q + PROBE_RAD * z), margin) @ z - steep) / PROBE_RAD
    return CLIMB_PER_S * steep / max(-bend, steep / LONGEST_RAD) * z


def third_level(s, x, K_N2, D_N2):
    """tau_mu = M Z^T (Z M Z^T)^-1 Z (K_N2 (x - v) - D_N2 v)."""
    Z = null_space(s.A)
    return s.M @ Z.T @ np.linalg.inv(Z @ s.M @ Z.T) @ Z @ (K_N2 * (x - s.v) - D_N2 * s.v)


def observe(s, tau, gain, period, integral, r):
    """Momentum observer r = K_o (p - integral(tau + C^T v - g + r)), p = M v. Return (next integral, next r)."""
    integral = integral + (tau + s.energy_slope - s.gravity + r) * period  # energy_slope is C^T v
    return integral, gain * (s.M @ s.v - integral)
