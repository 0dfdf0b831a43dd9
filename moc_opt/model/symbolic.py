"""The serial chain as numbers, and the same chain as CasADi functions that need no robot object.

`Chain` is what is left of a URDF when only positions matter: it serves the symbolic functions (for solvers
that differentiate the kinematics themselves) and the scan of the self-motion.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array, read_only

if TYPE_CHECKING:
    import casadi


@dataclass(frozen=True, eq=False)
class Chain:
    """Joint placements and axes of a serial arm; read-only arrays.

    Joint j sits at (rotations[j], origins[j]) in the frame of joint j - 1 (the world for j = 0) and turns
    about, or slides along, the unit vector axes[j] of its own frame.
    """

    rotations: Array
    """(n,3,3)"""
    origins: Array
    """(n,3) [m]"""
    axes: Array
    """(n,3)"""
    prismatic: NDArray[np.bool_]
    """(n,)"""
    offsets: Array
    """(2,3) tip and wrist in the last joint's frame [m]"""

    def __post_init__(self) -> None:
        for name in ("rotations", "origins", "axes", "prismatic", "offsets"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name)).copy()))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.axes)

    @property
    def joints(self) -> Array:
        """(n,16) for kernels: rotation by rows, origin, axis, and 1 where the joint slides."""
        parts = (self.rotations.reshape(-1, 9), self.origins, self.axes, self.prismatic[:, None])
        return np.hstack(parts).astype(np.float64)

    @property
    def fingerprint(self) -> str:
        """Twelve hex digits that change with any number of the chain."""
        digest = hashlib.sha256()
        for array in (self.rotations, self.origins, self.axes, self.prismatic, self.offsets):
            digest.update(array.tobytes())
        return digest.hexdigest()[:12]


@dataclass(frozen=True)
class Kinematics:
    """CasADi functions of q (n,) alone; two are equal when their ids are.

    mu and its gradient have no value at a singularity (J J^T not invertible): keep away from it.
    """

    id: str
    """Robot name and fingerprint of its geometry."""
    n: int
    tip: casadi.Function = field(compare=False, repr=False)
    """q -> (3,) [m]"""
    wrist: casadi.Function = field(compare=False, repr=False)
    """q -> (3,) [m]"""
    mu: casadi.Function = field(compare=False, repr=False)
    """q -> scalar, sqrt(det(J_tip J_tip^T))"""
    grad_mu: casadi.Function = field(compare=False, repr=False)
    """q -> (n,)"""
    shaft: casadi.Function = field(compare=False, repr=False)
    """q -> scalar, (mu_shaft / |X - N|^2)^2 of `manipulability_kernels.shaft_manipulability`; squared it has no kink"""


def build_kinematics(name: str, chain: Chain) -> Kinematics:
    """Write the chain's forward kinematics in CasADi SX; mu from the geometric Jacobian, grad mu by AD."""
    import casadi as ca  # late: half a second that only the NLP back-ends need

    q = ca.SX.sym("q", chain.n)
    rotation, origin = ca.SX.eye(3), ca.SX.zeros(3)
    joints: list[tuple[Any, Any]] = []  # world axis, world origin
    for j in range(chain.n):
        origin = origin + ca.mtimes(rotation, ca.DM(chain.origins[j]))
        rotation = ca.mtimes(rotation, ca.DM(chain.rotations[j]))
        axis = ca.DM(chain.axes[j])
        if chain.prismatic[j]:
            origin = origin + ca.mtimes(rotation, axis) * q[j]
        else:
            rotation = ca.mtimes(rotation, _rotation_about(ca, axis, q[j]))
        joints.append((ca.mtimes(rotation, axis), origin))
    tip, wrist = (origin + ca.mtimes(rotation, ca.DM(offset)) for offset in chain.offsets)
    jacobian, lever = (
        ca.horzcat(*(
            axis if slides else ca.cross(axis, point - at)
            for (axis, at), slides in zip(joints, chain.prismatic, strict=True)
        ))
        for point in (tip, wrist)
    )  # fmt: skip
    gram = ca.mtimes(jacobian, jacobian.T)
    mu = ca.sqrt(ca.det(gram))
    held = ca.mtimes([lever, jacobian.T, ca.inv_minor(gram)])
    rest = ca.mtimes(lever, lever.T) - ca.mtimes([held, jacobian, lever.T])
    minors = sum(rest[a, a] * rest[b, b] - rest[a, b] * rest[b, a] for a, b in ((0, 1), (1, 2), (2, 0)))
    shaft = minors / float(np.linalg.norm(chain.offsets[0] - chain.offsets[1])) ** 4
    outputs = {"tip": tip, "wrist": wrist, "mu": mu, "grad_mu": ca.gradient(mu, q), "shaft": shaft}
    functions = {key: ca.Function(key, [q], [value], ["q"], [key]) for key, value in outputs.items()}
    return Kinematics(id=f"{name}-{chain.fingerprint}", n=chain.n, **functions)


def _rotation_about(ca: Any, axis: Any, angle: Any) -> Any:
    """Return Rodrigues' formula: I + sin K + (1 - cos) K^2."""
    k = ca.skew(axis)
    return ca.DM.eye(3) + ca.sin(angle) * k + (1 - ca.cos(angle)) * ca.mtimes(k, k)
