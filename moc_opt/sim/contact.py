"""External forces on the arm: of the trocar's tissue on the tool shaft, and forces held on links.

The trocar is compliant: a spring and a damper between the trocar point and the nearest point of the shaft
line, acting across the shaft only, so that the tool slides and turns freely in the incision. A rigid ring
would wedge.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import PlantError, UnknownNameError
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit


@njit(cache=True, nogil=True)
def shaft_force(
    tip: Array, wrist: Array, twist: Array, origin: Array, trocar: Array, elapsed: float, stiffness: float,
    damping: float, force: Array, point: Array,
) -> None:  # fmt: skip
    """Compute the force of the trocar on the tool shaft.

    With the tool direction u, the shaft point c nearest to the trocar P and the velocity w of the tool's
    material at c:  force = (I - u u^T) (stiffness (P - c) + damping (dP - w)). Its power on the tool is -d/dt
    of the spring's energy minus what the damper takes, so a trocar at rest can only take energy out of the
    arm. The shaft's line has no ends: the tool is assumed to be inserted.

    Args:
        tip: (3,) tip of the tool, world axes [m].
        wrist: (3,) any other point of the shaft line, world axes [m].
        twist: (6,) angular velocity [rad/s], then the linear velocity [m/s] of the tool's material at
            `origin`.
        origin: (3,) where the linear velocity is taken, world axes [m].
        trocar: (2, 3) rows: trocar point P [m] and its velocity dP [m/s] at the start of the period.
        elapsed: time since the start of the period [s]; the trocar is at P + dP * elapsed.
        stiffness: [N/m].
        damping: [N s/m].
        force: (3,) written: force on the shaft, world axes [N].
        point: (3,) written: where it acts, world axes [m].
    """
    ux, uy, uz = tip[0] - wrist[0], tip[1] - wrist[1], tip[2] - wrist[2]
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length

    px = trocar[0, 0] + elapsed * trocar[1, 0]
    py = trocar[0, 1] + elapsed * trocar[1, 1]
    pz = trocar[0, 2] + elapsed * trocar[1, 2]
    along = (px - tip[0]) * ux + (py - tip[1]) * uy + (pz - tip[2]) * uz
    cx, cy, cz = tip[0] + along * ux, tip[1] + along * uy, tip[2] + along * uz

    rx, ry, rz = cx - origin[0], cy - origin[1], cz - origin[2]
    wx = twist[3] + twist[1] * rz - twist[2] * ry
    wy = twist[4] + twist[2] * rx - twist[0] * rz
    wz = twist[5] + twist[0] * ry - twist[1] * rx

    fx = stiffness * (px - cx) + damping * (trocar[1, 0] - wx)
    fy = stiffness * (py - cy) + damping * (trocar[1, 1] - wy)
    fz = stiffness * (pz - cz) + damping * (trocar[1, 2] - wz)
    axial = fx * ux + fy * uy + fz * uz
    force[0], force[1], force[2] = fx - axial * ux, fy - axial * uy, fz - axial * uz
    point[0], point[1], point[2] = cx, cy, cz


@njit(cache=True, nogil=True)
def add_force(wrench: Array, force: Array, point: Array, com: Array) -> None:
    """Add a force at a point to a body's wrench about its centre of mass.

    Args:
        wrench: (6,) changed in place: force [N], then moment about `com` [Nm], world axes (MuJoCo's
            `xfrc_applied`).
        force: (3,) [N].
        point: (3,) where the force acts, world axes [m].
        com: (3,) the body's centre of mass, world axes [m].
    """
    rx, ry, rz = point[0] - com[0], point[1] - com[1], point[2] - com[2]
    wrench[0] += force[0]
    wrench[1] += force[1]
    wrench[2] += force[2]
    wrench[3] += ry * force[2] - rz * force[1]
    wrench[4] += rz * force[0] - rx * force[2]
    wrench[5] += rx * force[1] - ry * force[0]


@njit(cache=True, nogil=True)
def load_bodies(
    wrenches: Array, xpos: Array, xmat: Array, xipos: Array, cvel: Array, origin: Array, tool: int, tip: int,
    wrist: int, trocar: Array, force: Array, point: Array, elapsed: float, stiffness: float, damping: float,
    pushed: NDArray[np.int64], pushes: Array,
) -> None:  # fmt: skip
    """Write the outside wrenches of one plant substep: trocar on the tool, held forces on the pushed bodies.

    Args:
        wrenches: (nbody, 6) written: `xfrc_applied`.
        xpos: (nbody, 3) body origins, world axes [m].
        xmat: (nbody, 9) body orientations, row-major.
        xipos: (nbody, 3) centres of mass, world axes [m].
        cvel: (nbody, 6) body twists (angular, then linear at `origin`) [rad/s, m/s].
        origin: (3,) where `cvel` takes its linear part, world axes [m].
        tool: body number of the tool.
        tip: body number of the tip.
        wrist: body number of the wrist.
        trocar: (2, 3) as in `shaft_force`; not used when stiffness and damping are both 0.
        force: (3,) written: the trocar's force on the shaft [N].
        point: (3,) scratch.
        elapsed: time since the start of the period [s].
        stiffness: [N/m].
        damping: [N s/m].
        pushed: (k,) body numbers under a held force.
        pushes: (k, 6) rows: force, world axes [N]; point of attack in the body's own axes [m].
    """
    wrenches[:, :] = 0.0
    if stiffness > 0.0 or damping > 0.0:
        shaft_force(xpos[tip], xpos[wrist], cvel[tool], origin, trocar, elapsed, stiffness, damping, force, point)
        add_force(wrenches[tool], force, point, xipos[tool])
    else:
        force[:] = 0.0
    for k in range(pushed.shape[0]):
        body = pushed[k]
        for i in range(3):
            point[i] = xpos[body, i]
            for j in range(3):
                point[i] += xmat[body, 3 * i + j] * pushes[k, 3 + j]
        add_force(wrenches[body], pushes[k, :3], point, xipos[body])


class Pushes:
    """External forces held on links until they are cleared."""

    def __init__(self, bodies: Mapping[str, int], coms: Array) -> None:
        """Build it for links by name -> body number, and centres of mass (nbody, 3) in own axes [m]."""
        self._bodies, self._coms = dict(bodies), coms
        self._held: dict[int, Array] = {}
        self._pack()

    def hold(self, link: str, force: ArrayLike, point: ArrayLike | None = None) -> None:
        """Hold a force (3,) [N], world axes, at a point (3,) [m] of the link's frame (None: centre of mass).

        Raises:
            UnknownNameError: no such link.
            PlantError: wrong shape or not finite.
        """
        body = self._number(link)
        where = self._coms[body] if point is None else _triple("push point", point, "m")
        self._held[body] = np.concatenate([_triple("push force", force, "N"), where])
        self._pack()

    def clear(self, link: str | None = None) -> None:
        """Remove the force on one link, or on all."""
        if link is None:
            self._held.clear()
        else:
            self._held.pop(self._number(link), None)
        self._pack()

    def _pack(self) -> None:
        self.bodies = np.array(list(self._held), dtype=np.int64)
        self.rows = np.array(list(self._held.values()), dtype=np.float64).reshape(-1, 6)

    def _number(self, link: str) -> int:
        if link not in self._bodies:
            raise UnknownNameError("link", link, self._bodies)
        return self._bodies[link]


def _triple(name: str, value: ArrayLike, unit: str) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise PlantError(f"{name} = {array.tolist()!r:.100}: give 3 finite numbers [{unit}]")
    return array
