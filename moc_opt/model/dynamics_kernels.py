"""Dynamics of the links' masses from their places: the gradient of the kinetic energy, and gravity.

`axes` (n,6) as in `kinematics_kernels`; `places` and `bodies` as in `kinematics_kernels.fill_state`.
"""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit


@njit(cache=True)
def mass_moment(places: Array, bodies: Array, k: int) -> tuple[float, float, float]:
    """Compute the mass of link k times its centre of mass in the world [kg m]."""
    m, a, b, c = bodies[k, 0], bodies[k, 1], bodies[k, 2], bodies[k, 3]
    x = m * places[k, 9] + places[k, 0] * a + places[k, 3] * b + places[k, 6] * c
    y = m * places[k, 10] + places[k, 1] * a + places[k, 4] * b + places[k, 7] * c
    z = m * places[k, 11] + places[k, 2] * a + places[k, 5] * b + places[k, 8] * c
    return x, y, z


@njit(cache=True)
def link_momentum(places: Array, bodies: Array, k: int, twist: Array, out: Array) -> None:
    """Write the momentum of link k into out[k], linear and angular at the world origin [kg m/s], [kg m^2/s].

    ``twist`` (6,) is its velocity [m/s], [rad/s] there.
    """
    m, (cx, cy, cz) = bodies[k, 0], mass_moment(places, bodies, k)
    xx, yx, zx = places[k, 0], places[k, 1], places[k, 2]  # the link's axes in the world
    xy, yy, zy = places[k, 3], places[k, 4], places[k, 5]
    xz, yz, zz = places[k, 6], places[k, 7], places[k, 8]
    vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    px, py, pz = m * vx + wy * cz - wz * cy, m * vy + wz * cx - wx * cz, m * vz + wx * cy - wy * cx
    # About the centre of mass, in the link's axes; then what the linear part adds at the origin.
    x, y, z = xx * wx + yx * wy + zx * wz, xy * wx + yy * wy + zy * wz, xz * wx + yz * wy + zz * wz
    ix = bodies[k, 4] * x + bodies[k, 5] * y + bodies[k, 7] * z
    iy = bodies[k, 5] * x + bodies[k, 6] * y + bodies[k, 8] * z
    iz = bodies[k, 7] * x + bodies[k, 8] * y + bodies[k, 9] * z
    scale = 1.0 / m if m > 0.0 else 0.0
    out[k, 0], out[k, 1], out[k, 2] = px, py, pz
    out[k, 3] = xx * ix + xy * iy + xz * iz + scale * (cy * pz - cz * py)
    out[k, 4] = yx * ix + yy * iy + yz * iz + scale * (cz * px - cx * pz)
    out[k, 5] = zx * ix + zy * iy + zz * iz + scale * (cx * py - cy * px)


@njit(cache=True)
def energy_slope(axes: Array, places: Array, bodies: Array, v: Array, out: Array) -> None:
    """Compute dT/dq (n,) [Nm], the slope of the kinetic energy, which is C^T v with Christoffel's C.

    Turning joint k takes all links beyond it along, but not the twist V of the links before it that carries them:
    dT/dq_k = (V x S_k) . H_k, with H_k the momentum of the links beyond, all at the world origin (Featherstone 2008,
    2.9, gives the cross product). Rotors move with their own joint only and have no part in it.
    """
    n = axes.shape[0]
    scratch = np.empty((2 * n + 1, 6))  # momenta, then V x S_k, then V
    twist = scratch[2 * n]
    for i in range(6):
        twist[i] = 0.0
    for k in range(n):
        t = n + k
        vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
        sx, sy, sz, rx, ry, rz = axes[k, 0], axes[k, 1], axes[k, 2], axes[k, 3], axes[k, 4], axes[k, 5]
        scratch[t, 0] = wy * sz - wz * sy + vy * rz - vz * ry
        scratch[t, 1] = wz * sx - wx * sz + vz * rx - vx * rz
        scratch[t, 2] = wx * sy - wy * sx + vx * ry - vy * rx
        scratch[t, 3], scratch[t, 4], scratch[t, 5] = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
        for i in range(6):
            twist[i] += axes[k, i] * v[k]
        link_momentum(places, bodies, k, twist, scratch)
    for k in range(n - 1, -1, -1):
        slope = 0.0
        for i in range(6):
            if k + 1 < n:
                scratch[k, i] += scratch[k + 1, i]
            slope += scratch[n + k, i] * scratch[k, i]
        out[k] = slope


@njit(cache=True)
def gravity_torque(axes: Array, places: Array, bodies: Array, field: Array, out: Array) -> None:
    """Compute the torque (n,) [Nm] that carries the arm's weight: joint k carries the links beyond it."""
    mass = cx = cy = cz = 0.0
    fx, fy, fz = field[0], field[1], field[2]
    for k in range(axes.shape[0] - 1, -1, -1):
        x, y, z = mass_moment(places, bodies, k)
        mass, cx, cy, cz = mass + bodies[k, 0], cx + x, cy + y, cz + z
        out[k] = -(
            mass * (axes[k, 0] * fx + axes[k, 1] * fy + axes[k, 2] * fz)
            + axes[k, 3] * (cy * fz - cz * fy)
            + axes[k, 4] * (cz * fx - cx * fz)
            + axes[k, 5] * (cx * fy - cy * fx)
        )
