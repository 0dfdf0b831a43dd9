"""Compiled kernels of the closed form: angles, manipulability and room to the limits over path, swivel and branch."""

from __future__ import annotations

import math

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

TURN = 2.0 * math.pi
STRAIGHT = 1e-9  # sine of joint 4 below which the elbow has no plane


@njit(cache=True)
def room_of(angle: float, half: float) -> float:
    """Compute the distance of an angle, taken whole turns nearer to zero, from the ends of [-half, half] [rad]."""
    return half - abs(angle - TURN * math.floor(angle / TURN + 0.5))


@njit(cache=True)
def elbow_circle(
    base: Array, shoulder: Array, upper: float, fore: float, reference: Array, wrist: Array, frame: Array
) -> tuple[float, float]:
    """Fill frame (3,3) with unit vectors from shoulder to wrist, of swivel 0 and of swivel 90 degrees, in the base.

    Returns:
        Distance of the circle's middle from the shoulder and its radius [m]; the radius is NaN out of reach.
    """
    way, line = np.empty(3), np.empty(3)
    for i in range(3):
        way[i] = wrist[i] - shoulder[i]
    span = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    ref = np.empty(3)
    for i in range(3):
        line[i] = (base[0, i] * way[0] + base[1, i] * way[1] + base[2, i] * way[2]) / span
        ref[i] = base[0, i] * reference[0] + base[1, i] * reference[1] + base[2, i] * reference[2]
    side_x = line[1] * ref[2] - line[2] * ref[1]
    side_y = line[2] * ref[0] - line[0] * ref[2]
    side_z = line[0] * ref[1] - line[1] * ref[0]
    size = math.sqrt(side_x**2 + side_y**2 + side_z**2)
    frame[0, :] = line
    frame[2, 0], frame[2, 1], frame[2, 2] = side_x / size, side_y / size, side_z / size
    frame[1, 0] = frame[2, 1] * line[2] - frame[2, 2] * line[1]
    frame[1, 1] = frame[2, 2] * line[0] - frame[2, 0] * line[2]
    frame[1, 2] = frame[2, 0] * line[1] - frame[2, 1] * line[0]
    along = (upper * upper + span * span - fore * fore) / (2.0 * span)
    square = upper * upper - along * along
    return along, math.sqrt(square) if square > (STRAIGHT * fore) ** 2 else math.nan


@njit(cache=True)
def fill_pose(
    frame: Array, along: float, radius: float, upper: float, fore: float, tool: float,
    cosine: float, sine: float, u: Array, span: float, angles: Array,
) -> float:
    """Fill the angles (6,) of the branch without negative signs, in the normal form; returns mu.

    Args:
        frame, along, radius: of `elbow_circle`.
        upper, fore, tool: of `Spherical` [m].
        cosine, sine: of the swivel.
        u: (3,) direction of axis 7, in the base.
        span: |S N| [m].
        angles: (6,) to fill [rad].
    """
    ex = along * frame[0, 0] + radius * (cosine * frame[1, 0] + sine * frame[2, 0])
    ey = along * frame[0, 1] + radius * (cosine * frame[1, 1] + sine * frame[2, 1])
    ez = along * frame[0, 2] + radius * (cosine * frame[1, 2] + sine * frame[2, 2])
    wx, wy, wz = span * frame[0, 0], span * frame[0, 1], span * frame[0, 2]
    ux, uy, uz = u[0], u[1], u[2]
    a3x, a3y, a3z = ex / upper, ey / upper, ez / upper
    a5x, a5y, a5z = (wx - ex) / fore, (wy - ey) / fore, (wz - ez) / fore
    flat = math.sqrt(a3x * a3x + a3y * a3y)
    c1, s1 = (a3x / flat, a3y / flat) if flat > 0.0 else (1.0, 0.0)
    c4 = a3x * a5x + a3y * a5y + a3z * a5z
    # axis 4 = a3 x a5 / sin t4
    a4x, a4y, a4z = a3y * a5z - a3z * a5y, a3z * a5x - a3x * a5z, a3x * a5y - a3y * a5x
    s4 = math.sqrt(a4x * a4x + a4y * a4y + a4z * a4z)
    a4x, a4y, a4z = a4x / s4, a4y / s4, a4z / s4
    angles[0] = math.atan2(s1, c1)
    angles[1] = math.atan2(flat, a3z)
    # axis 5 seen from the frame behind joint 2: x there is y x a3
    a2x, a2y = -s1, c1
    across = a2y * a3z * a5x - a2x * a3z * a5y + (a2x * a3y - a2y * a3x) * a5z
    angles[2] = math.atan2(a2x * a5x + a2y * a5y, across)
    angles[3] = math.atan2(s4, c4)
    # axis 7 seen from the frame behind joint 4: x = a4 x a5, y = a4, z = a5
    xx, xy, xz = a4y * a5z - a4z * a5y, a4z * a5x - a4x * a5z, a4x * a5y - a4y * a5x
    px, py = xx * ux + xy * uy + xz * uz, a4x * ux + a4y * uy + a4z * uz
    s6 = math.sqrt(px * px + py * py)
    c5, s5 = (px / s6, py / s6) if s6 > 0.0 else (1.0, 0.0)
    angles[4] = math.atan2(s5, c5)
    angles[5] = math.atan2(s6, a5x * ux + a5y * uy + a5z * uz)
    a6x, a6y, a6z = c5 * a4x - s5 * xx, c5 * a4y - s5 * xy, c5 * a4z - s5 * xz
    # columns of J_T: axis x lever, levers from shoulder, elbow and wrist
    lx, ly, lz = tool * ux, tool * uy, tool * uz
    rx, ry, rz = wx + lx, wy + ly, wz + lz
    fx, fy, fz = rx - ex, ry - ey, rz - ez
    xx1, yy1 = -ry, rx  # axis 1 is z
    xx2, yy2, zz2 = a2y * rz, -a2x * rz, a2x * ry - a2y * rx
    xx3, yy3, zz3 = a3y * rz - a3z * ry, a3z * rx - a3x * rz, a3x * ry - a3y * rx
    xx4, yy4, zz4 = a4y * fz - a4z * fy, a4z * fx - a4x * fz, a4x * fy - a4y * fx
    xx5, yy5, zz5 = a5y * lz - a5z * ly, a5z * lx - a5x * lz, a5x * ly - a5y * lx
    xx6, yy6, zz6 = a6y * lz - a6z * ly, a6z * lx - a6x * lz, a6x * ly - a6y * lx
    a = xx1 * xx1 + xx2 * xx2 + xx3 * xx3 + xx4 * xx4 + xx5 * xx5 + xx6 * xx6
    b = xx1 * yy1 + xx2 * yy2 + xx3 * yy3 + xx4 * yy4 + xx5 * yy5 + xx6 * yy6
    c = xx2 * zz2 + xx3 * zz3 + xx4 * zz4 + xx5 * zz5 + xx6 * zz6
    d = yy1 * yy1 + yy2 * yy2 + yy3 * yy3 + yy4 * yy4 + yy5 * yy5 + yy6 * yy6
    e = yy2 * zz2 + yy3 * zz3 + yy4 * zz4 + yy5 * zz5 + yy6 * zz6
    f = zz2 * zz2 + zz3 * zz3 + zz4 * zz4 + zz5 * zz5 + zz6 * zz6
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return math.sqrt(max(det, 0.0))


@njit(cache=True)
def fill_map(
    base: Array, shoulder: Array, upper: float, fore: float, tool: float,
    offset: Array, middle: Array, half: Array, reference: Array, tips: Array, wrists: Array, swivels: Array,
    angles: Array, mu: Array, room: Array,
) -> None:
    """Fill angles (k,m,6), mu (k,m) and room (k,8,m), the distance to the nearest joint limit; NaN out of reach.

    Args:
        base to half: of `Spherical`.
        reference: (3,) the direction that swivels count from.
        tips, wrists: (k,3) [m].
        swivels: (k,m) [rad].
    """  # fmt: skip
    frame, u = np.empty((3, 3)), np.empty(3)
    kept, turned = np.empty(6), np.empty(6)
    for k in range(tips.shape[0]):
        along, radius = elbow_circle(base, shoulder, upper, fore, reference, wrists[k], frame)
        if math.isnan(radius):
            angles[k], mu[k], room[k] = np.nan, np.nan, np.nan
            continue
        span = 0.0
        for i in range(3):
            span += (wrists[k, i] - shoulder[i]) ** 2
            u[i] = 0.0
            for j in range(3):
                u[i] += base[j, i] * (tips[k, j] - wrists[k, j]) / tool
        span = math.sqrt(span)
        for m in range(swivels.shape[1]):
            found = angles[k, m]
            mu[k, m] = fill_pose(
                frame, along, radius, upper, fore, tool,
                math.cos(swivels[k, m]), math.sin(swivels[k, m]), u, span, found,
            )  # fmt: skip
            for j in range(6):
                away = offset[j] + middle[j]
                kept[j] = room_of(found[j] - away, half[j])
                other = -found[j] if j % 2 else found[j] + math.pi
                turned[j] = room_of(other - away, half[j])
            for branch in range(8):
                s, e, w = branch & 1, branch >> 1 & 1, branch >> 2
                least = turned[0] if s else kept[0]
                least = min(least, turned[1] if s else kept[1])
                least = min(least, turned[2] if s != e else kept[2])
                least = min(least, turned[3] if e else kept[3])
                least = min(least, turned[4] if e != w else kept[4])
                room[k, branch, m] = min(least, turned[5] if w else kept[5])


@njit(cache=True)
def fill_poses(offset: Array, middle: Array, angles: Array, poses: Array) -> None:
    """Fill joints 1 to 6 of poses (8,m,7) from the angles (m,6) of the branch without negative signs [rad]."""
    for branch in range(8):
        s, e, w = branch & 1, branch >> 1 & 1, branch >> 2
        flips = (s, s, s ^ e, e, e ^ w, w)
        for m in range(angles.shape[0]):
            for j in range(6):
                value = angles[m, j]
                if flips[j]:
                    value = -value if j % 2 else value + math.pi
                value -= offset[j] + middle[j]
                poses[branch, m, j] = middle[j] + value - TURN * math.floor(value / TURN + 0.5)
